//! Judges what `bench latency --cyclictest --json` said; `benchmarks/lateness.sh` measures and calls this.
//!
//! ```text
//! cargo run --release -p benchmarks --bin lateness -- idle.json loaded.json
//! ```

use benchmarks::{Target, exit};
use serde_json::Value;
use std::error::Error;
use std::process::ExitCode;

/// Loop over cyclictest, by the key of the ratio.
const AGAINST_CYCLICTEST: [(&str, &str, Target); 3] = [
    ("p50", "p50", Target::AtMost(1.1)),
    ("p99", "p99, median of slices", Target::AtMost(1.25)),
    ("late", "wake-ups over 2 ms", Target::AtMost(1.5)),
];
/// Median of the slices' p99 with ten subscribers, one stalled and one killed, over that with none.
const TEN_SUBSCRIBERS: Target = Target::AtMost(1.1);
/// Duration of a tick: p50 and median of the slices' p99, us.
const TICK: [(&str, Target); 2] = [("p50", Target::AtMost(5.0)), ("slice_p99", Target::AtMost(25.0))];
/// From the loop's wake-up to a subscriber, p50, us.
const TO_SUBSCRIBER: Target = Target::AtMost(60.0);

fn main() -> ExitCode {
    let files: Vec<String> = std::env::args().skip(1).collect();
    if files.is_empty() {
        eprintln!("expected files that `bench latency --cyclictest --json` wrote, got none");
        return ExitCode::from(2);
    }
    exit(files.iter().try_fold(true, |all, file| Ok(judge(file)? & all)))
}

fn judge(file: &str) -> Result<bool, Box<dyn Error>> {
    let text = std::fs::read_to_string(file).map_err(|e| format!("{file}: {e}"))?;
    let json: Value = serde_json::from_str(&text).map_err(|e| format!("{file}: {e}"))?;
    println!("{file}: {} slices of {} s", json["slices"], json["slice_s"]);
    let mut judged = Judged { file, json: &json, all_reached: true };
    for (key, name, target) in AGAINST_CYCLICTEST {
        let path = format!("/ratio_cyclictest/{key}");
        // Where cyclictest was never late there is no ratio; then the loop must not be late either.
        if key == "late" && json.pointer(&path).is_some_and(Value::is_null) {
            let late = judged.number("/over_2ms")?;
            judged.say(name, if late == 0.0 { 0.0 } else { f64::INFINITY }, target);
        } else {
            let ratio = judged.number(&path)?;
            judged.say(&format!("{name}, loop over cyclictest"), ratio, target);
        }
    }
    for (name, of) in [("loop", "lateness_us"), ("bare loop", "bare_us"), ("cyclictest", "cyclictest_us")] {
        let [p50, p99] = ["p50", "slice_p99"].map(|key| judged.number(&format!("/{of}/{key}")));
        println!("    {name}: p50 {:.1} us, p99 {:.1} us", p50?, p99?);
    }
    let ten = judged.number("/subscribers/10/against_none/p99")?;
    judged.say("p99, ten subscribers over none", ten, TEN_SUBSCRIBERS);
    for (key, target) in TICK {
        let us = judged.number(&format!("/tick_us/{key}"))?;
        judged.say(&format!("tick, {key}, us"), us, target);
    }
    let us = judged.number("/to_subscriber_us/p50")?;
    judged.say("wake-up to subscriber, p50, us", us, TO_SUBSCRIBER);
    Ok(judged.all_reached)
}

struct Judged<'a> {
    file: &'a str,
    json: &'a Value,
    all_reached: bool,
}

impl Judged<'_> {
    fn number(&self, path: &str) -> Result<f64, String> {
        let value = self.json.pointer(path).and_then(Value::as_f64);
        value.ok_or_else(|| format!("{}: expected a number at {path}; was it measured with --cyclictest?", self.file))
    }

    fn say(&mut self, name: &str, figure: f64, target: Target) {
        println!("  {name:<44}{figure:>8.2}   {}", target.judge(figure));
        self.all_reached &= target.reached_by(figure);
    }
}
