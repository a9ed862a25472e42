//! The paper's experiments, shorter and in many variants.
//!
//! Durations are whole multiples of 4 ms, the longest time between two rows.

use super::plan::{Stream, chance};
use super::rig::Rig;
use crate::failure::{Failure, Kind};
use profiles::Script;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// The experiments of a case in the order in which each needs the results of the one before.
///
/// # Errors
/// None but a defect: a script that is not understood.
pub fn scripts(rig: &Rig, seed: u64, case: usize) -> Result<Vec<Script>, Failure> {
    let mut rng = chance(seed, Stream::Scripts, case as u64);
    let mut lengths = Lengths { rng: &mut rng, length: rig.length };
    let fill = rig.fill_bar;
    let texts = [
        torque_map(&mut lengths),
        volume_map(&mut lengths),
        pump_map(&mut lengths),
        clamp_steps(&mut lengths),
        constant_flow(&mut lengths, fill),
        format!("{}{BYPASSED}", random("random_a", "identify", &mut lengths, fill)),
        square("square_a", "identify", "horizontal", 0.6, &mut lengths, fill),
        square("square_b", "identify", "horizontal", 0.85, &mut lengths, fill),
        square("square_h", "validate", "horizontal", 0.9, &mut lengths, fill),
        square("square_v", "validate", "vertical", 0.9, &mut lengths, fill),
        random("random_b", "validate", &mut lengths, fill),
    ];
    let parse = |text: &String| Script::parse(text, "blind").map_err(|e| Failure::of(Kind::Internal, &e));
    texts.iter().map(parse).collect()
}

/// Lengths of a case.
struct Lengths<'a> {
    rng: &'a mut ChaCha8Rng,
    length: f64,
}

impl Lengths<'_> {
    /// Between the shortest and the usual one, some more or less by chance.
    fn of(&mut self, shortest: f64, usual: f64) -> f64 {
        (shortest + self.length * (usual - shortest)) * self.rng.random_range(0.85..1.15)
    }

    fn whole(&mut self, fewest: usize, usual: usize) -> usize {
        (self.of(fewest as f64, usual as f64).round() as usize).clamp(fewest, usual + 1)
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    /// A duration, s.
    fn time(&mut self, shortest: f64, usual: f64) -> f64 {
        whole_steps(self.of(shortest, usual))
    }
}

/// The nearest multiple of 4 ms.
fn whole_steps(seconds: f64) -> f64 {
    (seconds * 250.0).round() / 250.0
}

/// Evenly from `-most` to `most`.
fn even(count: usize, most: f64) -> Vec<f64> {
    (0..count).map(|i| most * (2.0 * i as f64 / (count - 1) as f64 - 1.0)).collect()
}

fn list(values: impl IntoIterator<Item = f64>) -> String {
    let words: Vec<String> = values.into_iter().map(|v| format!("{v:.4}")).collect();
    format!("[{}]", words.join(", "))
}

fn head(name: &str, protocol: &str, role: &str, plane: &str, start: &str) -> String {
    format!("name = \"{name}\"\nprotocol = \"{protocol}\"\nrole = \"{role}\"\nplane = \"{plane}\"\n[start]\n{start}\n")
}

/// A free lever at rest for about a second.
fn free(name: &str, protocol: &str, role: &str, plane: &str, lengths: &mut Lengths<'_>, fill_bar: f64) -> String {
    let rest_s = whole_steps(lengths.within(0.9, 1.3));
    let start = format!("fixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = {fill_bar:.3}");
    format!("{}[[step]]\nfor_s = {rest_s}\n", head(name, protocol, role, plane, &start))
}

fn torque_map(lengths: &mut Lengths<'_>) -> String {
    let count = lengths.whole(5, 9);
    let angles = even(count, lengths.within(34.0, 40.0));
    let levels = lengths.whole(2, 3);
    let most = lengths.within(0.075, 0.088);
    let shares: Vec<f64> = (0..levels).map(|i| most * (1.0 - 0.4 * i as f64 / (levels - 1).max(1) as f64)).collect();
    let shares = shares.iter().map(|s| -s).chain(shares.iter().rev().copied());
    let start = format!(
        "fixture = \"clamped\"\nangle_deg = {:.4}\nbrake = \"open\"\nbypass = \"open\"\nfill_bar = {:.3}",
        angles[0],
        lengths.within(3.0, 3.3)
    );
    format!(
        r#"{head}
[[step]]
for_s = 0.4
[[step]]
for_each = {{ angle_deg = {angles} }}
  [[step.step]]
  voltage_v = 0.0
  bypass = "open"
  fixture = "driven"
  angle_deg = "$angle_deg"
  rate_deg_s = 10.0
  [[step.step]]
  new_segment = false
  for_s = 0.4
  [[step.step]]
  for_each = {{ share = {shares} }}
    [[step.step.step]]
    voltage_u_max = "$share"
    bypass = "closed"
    fixture = "clamped"
    angle_deg = "$angle_deg"
    until = [
      {{ channel = "pressure1_bar", rate_below = 0.03, window_s = 0.8 }},
      {{ channel = "pressure1_bar", above = 5.4 }},
      {{ channel = "pressure2_bar", above = 5.4 }},
      {{ channel = "pressure1_bar", below = 1.25 }},
      {{ channel = "pressure2_bar", below = 1.25 }},
    ]
    timeout_s = {timeout}
"#,
        head = head("torque_map", "torque-map", "identify", "horizontal", &start),
        angles = list(angles),
        shares = list(shares),
        timeout = lengths.time(4.0, 8.0),
    )
}

fn volume_map(lengths: &mut Lengths<'_>) -> String {
    let count = lengths.whole(4, 7);
    let angles = even(count, lengths.within(30.0, 36.0));
    let reach = lengths.within(5.0, 6.0);
    let fill = lengths.within(2.6, 2.9);
    format!(
        r#"{head}
[[step]]
for_each = {{ angle_deg = {angles}, low_deg = {low}, high_deg = {high} }}
  [[step.step]]
  fixture = "filled"
  angle_deg = "$angle_deg"
  pressure1_bar = {fill:.3}
  pressure2_bar = {fill:.3}
  for_s = 0.02
  [[step.step]]
  fixture = "driven"
  angle_deg = "$high_deg"
  rate_deg_s = {rate:.3}
  until = [{{ channel = "pressure1_bar", below = 1.7 }}, {{ channel = "pressure2_bar", above = 4.8 }}]
  [[step.step]]
  new_segment = false
  fixture = "driven"
  angle_deg = "$low_deg"
  rate_deg_s = {rate:.3}
  until = [{{ channel = "pressure2_bar", below = 1.7 }}, {{ channel = "pressure1_bar", above = 4.8 }}]
  [[step.step]]
  new_segment = false
  fixture = "driven"
  angle_deg = "$angle_deg"
  rate_deg_s = {rate:.3}
  [[step.step]]
  new_segment = false
  fixture = "clamped"
  angle_deg = "$angle_deg"
  for_s = 0.004
"#,
        head = head(
            "volume_map",
            "volume-map",
            "identify",
            "horizontal",
            &format!(
                "fixture = \"clamped\"\nangle_deg = {:.4}\nbrake = \"closed\"\nbypass = \"closed\"\nfill_bar = 2.75",
                angles[0]
            )
        ),
        low = list(angles.iter().map(|a| a - reach)),
        high = list(angles.iter().map(|a| a + reach)),
        angles = list(angles.iter().copied()),
        rate = lengths.within(0.8, 1.6),
    )
}

fn pump_map(lengths: &mut Lengths<'_>) -> String {
    let count = lengths.whole(3, 4);
    let loads: Vec<f64> = (0..count).map(|i| 1.5 + 3.8 * i as f64 / (count - 1) as f64).collect();
    let levels = lengths.whole(4, 6);
    let shares: Vec<f64> = (0..levels).map(|i| 0.16 + 0.84 * (i as f64 / (levels - 1) as f64).powf(1.3)).collect();
    let for_s = lengths.time(1.6, 3.0);
    let side = |ports: [&str; 2], sign: f64| {
        format!(
            r#"[[step]]
for_each = {{ load_bar = {loads} }}
  [[step.step]]
  voltage_v = 0.0
  fixture = "pump-bench"
  pressure1_bar = {p1}
  pressure2_bar = {p2}
  for_s = 0.2
  [[step.step]]
  for_each = {{ share = {shares} }}
    [[step.step.step]]
    voltage_u_max = "$share"
    for_s = {for_s}
"#,
            loads = list(loads.iter().copied()),
            shares = list(shares.iter().map(|s| sign * s)),
            p1 = ports[0],
            p2 = ports[1],
        )
    };
    let start =
        "fixture = \"pump-bench\"\npressure1_bar = 1.5\npressure2_bar = 1.5\nbrake = \"open\"\nbypass = \"closed\"";
    format!(
        "{}{}{}",
        head("pump_map", "pump-map", "identify", "horizontal", start),
        side(["\"$load_bar\"", "1.5"], 1.0),
        side(["1.5", "\"$load_bar\""], -1.0)
    )
}

fn clamp_steps(lengths: &mut Lengths<'_>) -> String {
    let count = lengths.whole(4, 9);
    let angles = even(count, lengths.within(34.0, 40.0));
    let start = format!(
        "fixture = \"clamped\"\nangle_deg = {:.4}\nbrake = \"closed\"\nbypass = \"closed\"\nfill_bar = 2.75",
        angles[0]
    );
    format!(
        r#"{head}
[[step]]
for_each = {{ angle_deg = {angles} }}
  [[step.step]]
  fixture = "filled"
  angle_deg = "$angle_deg"
  pressure1_bar = 5.5
  pressure2_bar = 2.75
  for_s = 0.02
  [[step.step]]
  fixture = "released"
  angle_deg = "$angle_deg"
  release_ml_s = 0.0
  for_s = {rest}
  [[step.step]]
  new_segment = false
  fixture = "clamped"
  angle_deg = "$angle_deg"
  for_s = 0.004
  [[step.step]]
  repeat = 10
  stop_when = [{{ channel = "pressure1_bar", below = 1.65 }}]
    [[step.step.step]]
    fixture = "released"
    angle_deg = "$angle_deg"
    release_ml_s = {rate:.3}
    for_s = 0.3
    [[step.step.step]]
    new_segment = false
    fixture = "released"
    angle_deg = "$angle_deg"
    release_ml_s = 0.0
    for_s = {rest}
    [[step.step.step]]
    new_segment = false
    fixture = "clamped"
    angle_deg = "$angle_deg"
    for_s = 0.004
"#,
        head = head("clamp_steps", "clamp-steps", "identify", "horizontal", &start),
        angles = list(angles.iter().copied()),
        rest = lengths.time(1.0, 2.0),
        rate = lengths.within(2.8, 4.2),
    )
}

fn constant_flow(lengths: &mut Lengths<'_>, fill_bar: f64) -> String {
    let count = lengths.whole(6, 14);
    let most = lengths.within(12.0, 14.0);
    let flows = (0..count).map(|i| 1.0 + (most - 1.0) * i as f64 / (count - 1) as f64);
    let turn = lengths.within(22.0, 26.0);
    format!(
        r#"{head}
[[step]]
for_each = {{ flow_ml_s = {flows} }}
  [[step.step]]
  voltage_u_max = -0.7
  until = [{{ channel = "angle_deg", below = {low:.3} }}]
  timeout_s = 10.0
  [[step.step]]
  new_segment = false
  voltage_v = 0.0
  for_s = 0.3
  [[step.step]]
  flow_ml_s = "$flow_ml_s"
  until = [{{ channel = "angle_deg", above = {turn:.3} }}]
  timeout_s = 6.0
  [[step.step]]
  new_segment = false
  voltage_v = 0.0
  for_s = 0.3
"#,
        head = free("constant_flow", "constant-flow", "identify", "horizontal", lengths, fill_bar),
        flows = list(flows),
        low = -turn,
    )
}

/// By chance alone a short random run may never open the bypass, and then says nothing of its valve, which validation runs use.
const BYPASSED: &str = r#"[[step]]
for_each = { share = [0.5, -0.5] }
  [[step.step]]
  voltage_u_max = "$share"
  bypass = "open"
  for_s = 1.0
"#;

fn random(name: &str, role: &str, lengths: &mut Lengths<'_>, fill_bar: f64) -> String {
    format!(
        r#"{head}
[[step]]
[step.random]
total_s = {total}
length_s = [0.2, {longest:.2}]
voltage_u_max = [0.04, {most:.3}]
zero_share = 0.1
brake_closed_share = {brake:.3}
bypass_open_share = {bypass:.3}
guard_deg = {guard:.2}
"#,
        head = free(name, "random-steps", role, "horizontal", lengths, fill_bar),
        total = lengths.time(30.0, 80.0),
        longest = lengths.within(1.8, 3.0),
        most = lengths.within(0.85, 0.97),
        brake = lengths.within(0.08, 0.16),
        bypass = lengths.within(0.08, 0.16),
        guard = lengths.within(22.0, 26.0),
    )
}

fn square(name: &str, role: &str, plane: &str, share: f64, lengths: &mut Lengths<'_>, fill_bar: f64) -> String {
    let share = share * lengths.within(0.93, 1.05);
    let turn = if plane == "vertical" { lengths.within(24.0, 28.0) } else { lengths.within(27.0, 31.0) };
    format!(
        r#"{head}
[[step]]
repeat = {repeat}
  [[step.step]]
  voltage_u_max = {share:.4}
  until = [{{ channel = "angle_deg", above = {turn:.3} }}]
  timeout_s = 8.0
  [[step.step]]
  voltage_u_max = {back:.4}
  until = [{{ channel = "angle_deg", below = {low:.3} }}]
  timeout_s = 8.0
"#,
        head = free(name, "square-wave", role, plane, lengths, fill_bar),
        repeat = lengths.whole(2, 4),
        back = -share,
        low = -turn,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::rig::draw;

    #[test]
    fn every_case_has_scripts_that_a_rig_can_play() {
        for case in 0..40 {
            let rig = draw(7, case, 0);
            let scripts = scripts(&rig, 7, case).expect("scripts that are understood");
            assert_eq!(scripts.len(), 11);
            assert_eq!(scripts.iter().filter(|s| s.role == profiles::Role::Validate).count(), 3);
        }
    }
}
