//! Recordings: what an hour of samples costs to write, how large it is, and how fast it is read back.
//!
//! ```text
//! cargo run --release -p benchmarks --bin recording              # an hour of the emulated rig in virtual time
//! cargo run --release -p benchmarks --bin recording -- RUN.mcap  # the samples of this recording, again and again for an hour
//! ```
//!
//! Everything runs on one core. Rates are by the CPU time of the thread, so that what else the machine does counts little; the clock's are
//! given beside them.

use benchmarks::{Bench, Target, exit};
use recordings::{AmplifierReport, CsvWriter, Item, McapReader, McapWriter, Plane, Protocol, Role, Rows, RunMetadata};
use rt_core::{Handover, PERIOD_NS, Publish, Sample, flags};
use rustix::thread::{CpuSet, sched_setaffinity};
use rustix::time::{ClockId, clock_gettime};
use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::ExitCode;

/// Samples of an hour at 1 kHz.
const HOUR: u64 = 3_600_000;
/// Reports of the amplifier come at this distance, ticks.
const REPORT_TICKS: u64 = 20;
/// Reads of each kind; the fastest counts.
const ROUNDS: u32 = 3;

/// Share of one core that writing takes in real time, %.
const TARGET_WRITE_PERCENT: Target = Target::AtMost(3.0);
/// Size of an hour, MB.
const TARGET_SIZE_MB: Target = Target::AtMost(600.0);
/// Samples read and decoded, millions a second.
const TARGET_READ: Target = Target::AtLeast(5.0);
/// Rows exported to CSV, thousands a second.
const TARGET_EXPORT: Target = Target::AtLeast(300.0);
/// Memory that grows while the hour is read, MB: nothing to speak of.
const TARGET_GROWTH_MB: Target = Target::AtMost(4.0);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match &arguments[..] {
        [] => one_core().and_then(|()| measure(&emulated()?)),
        [path] => one_core().and_then(|()| measure(&recorded(Path::new(path))?)),
        _ => {
            eprintln!("expected one recording or nothing, got {arguments:?}");
            return ExitCode::from(2);
        }
    };
    exit(outcome)
}

fn one_core() -> Result<(), Box<dyn Error>> {
    let mut cpus = CpuSet::new();
    cpus.set(0);
    Ok(sched_setaffinity(None, &cpus)?)
}

/// Samples of a run that are written again and again.
struct Source {
    name: String,
    samples: Vec<Sample>,
}

/// Keeps the samples.
struct Kept<'s>(&'s mut Vec<Sample>);

impl Publish for Kept<'_> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.0.push(*sample);
        Handover::Taken
    }
}

/// The emulated rig in virtual time: random steps, as a campaign records them.
fn emulated() -> Result<Source, Box<dyn Error>> {
    let mut bench = Bench::new("random_a", str::to_owned)?;
    let mut samples = Vec::new();
    bench.run_new(0, &mut Kept(&mut samples))?;
    Ok(Source { name: "emulated rig, random steps, virtual time".to_owned(), samples })
}

fn recorded(path: &Path) -> Result<Source, Box<dyn Error>> {
    let mut samples = Vec::new();
    for item in McapReader::open(path)? {
        if let Item::Sample(sample) = item? {
            samples.push(sample);
        }
    }
    if samples.is_empty() {
        return Err(format!("{}: expected samples, got none", path.display()).into());
    }
    Ok(Source { name: path.display().to_string(), samples })
}

impl Source {
    /// Sample `tick` of the hour. The run's own samples repeat; times go on.
    fn at(&self, tick: u64) -> Sample {
        let mut sample = self.samples[(tick % self.samples.len() as u64) as usize];
        let begin_ns = sample.woken_ns.saturating_sub(sample.scheduled_ns);
        (sample.tick, sample.scheduled_ns, sample.skipped) = (tick, tick * PERIOD_NS, 0);
        if sample.woken_ns > 0 {
            sample.woken_ns = begin_ns + sample.scheduled_ns;
        }
        sample.flags &= !flags::LAST;
        if tick + 1 == HOUR {
            sample.flags |= flags::LAST;
        }
        sample
    }
}

fn measure(source: &Source) -> Result<bool, Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let path = dir.path().join("hour.mcap");
    println!("an hour of samples: {} ({} different ones)", source.name, source.samples.len());
    let (begin_mb, begin_s) = (resident_mb()?, Spent::now());
    for tick in 0..HOUR {
        // What making them takes is not the writer's.
        std::hint::black_box(source.at(tick));
    }
    let made_s = begin_s.since();
    let begin_s = Spent::now();
    write(source, &path)?;
    let write_s = begin_s.since();
    let write_mb = resident_mb()? - begin_mb;
    let percent = (write_s.cpu - made_s.cpu) / (HOUR * PERIOD_NS) as f64 * 1e9 * 100.0;
    let size_mb = std::fs::metadata(&path)?.len() as f64 * 1e-6;
    let mut reached = said("written: share of a core in real time, %", percent, TARGET_WRITE_PERCENT);
    reached &= said("size, MB", size_mb, TARGET_SIZE_MB);

    let before_mb = resident_mb()?;
    let read = fastest(|| read(&path))?;
    reached &= said("read and decoded, million samples/s of CPU", HOUR as f64 * 1e-6 / read.cpu, TARGET_READ);
    println!("{:<46}{:>10.2}", "    by the clock", HOUR as f64 * 1e-6 / read.clock);
    let rows = fastest(|| rows(&path, &mut |_| Ok(())))?;
    println!("{:<46}{:>10.2}", "as columns, million rows/s of CPU", HOUR as f64 * 1e-6 / rows.cpu);
    let export = fastest(|| export(&path, &dir.path().join("hour.csv")))?;
    reached &= said("exported to CSV, thousand rows/s of CPU", HOUR as f64 * 1e-3 / export.cpu, TARGET_EXPORT);
    println!("{:<46}{:>10.2}", "    by the clock", HOUR as f64 * 1e-3 / export.clock);
    let growth_mb = resident_mb()? - before_mb;
    println!("{:<46}{write_mb:>10.1}", "memory while writing grew by, MB");
    reached &= said("memory while reading grew by, MB", growth_mb, TARGET_GROWTH_MB);
    Ok(reached)
}

fn said(what: &str, figure: f64, target: Target) -> bool {
    println!("{what:<46}{figure:>10.2}   {}", target.judge(figure));
    target.reached_by(figure)
}

fn write(source: &Source, path: &Path) -> Result<(), Box<dyn Error>> {
    let run = RunMetadata::new("hour", Protocol::RandomSteps, Role::Validate, Plane::Horizontal);
    let mut writer = McapWriter::create(path, &run)?;
    for tick in 0..HOUR {
        writer.write(&source.at(tick))?;
        if tick % REPORT_TICKS == 0 {
            let (arrived_ns, supply_v) = (tick * PERIOD_NS, 24.0);
            writer.write_amplifier(&AmplifierReport { tick, arrived_ns, supply_v, ..AmplifierReport::BLANK })?;
        }
    }
    let certificate = writer.certificate(HOUR);
    writer.finish(&certificate)?;
    Ok(())
}

fn read(path: &Path) -> Result<(), Box<dyn Error>> {
    let (mut samples, mut sum) = (0, 0.0);
    for item in McapReader::open(path)? {
        if let Item::Sample(sample) = item? {
            samples += 1;
            sum += sample.voltage_v;
        }
    }
    std::hint::black_box(sum);
    all(samples)
}

/// Takes a block of rows.
type Take<'a> = &'a mut dyn FnMut(&recordings::Recording) -> Result<(), Box<dyn Error>>;

fn rows(path: &Path, take: Take<'_>) -> Result<(), Box<dyn Error>> {
    let mut count = 0;
    for block in Rows::open(path)? {
        let block = block?;
        count += block.len() as u64;
        take(&block)?;
    }
    all(count)
}

/// Where values were put back to their times, the last rows are left out.
fn all(samples: u64) -> Result<(), Box<dyn Error>> {
    if samples < HOUR - 10_000 { Err(format!("expected {HOUR} samples, got {samples}").into()) } else { Ok(()) }
}

fn export(path: &Path, csv: &Path) -> Result<(), Box<dyn Error>> {
    let mut writer = CsvWriter::new(BufWriter::with_capacity(1 << 20, File::create(csv)?), csv)?;
    rows(path, &mut |block| Ok(writer.write(block)?))?;
    writer.into_inner().flush()?;
    Ok(())
}

/// Time of this thread and of the clock, s.
#[derive(Clone, Copy)]
struct Spent {
    cpu: f64,
    clock: f64,
}

impl Spent {
    fn now() -> Spent {
        let now = |clock| {
            let time = clock_gettime(clock);
            time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
        };
        Spent { cpu: now(ClockId::ThreadCPUTime), clock: now(ClockId::Monotonic) }
    }

    fn since(self) -> Spent {
        let now = Spent::now();
        Spent { cpu: now.cpu - self.cpu, clock: now.clock - self.clock }
    }
}

fn fastest(mut run: impl FnMut() -> Result<(), Box<dyn Error>>) -> Result<Spent, Box<dyn Error>> {
    let mut best = Spent { cpu: f64::INFINITY, clock: f64::INFINITY };
    for _ in 0..ROUNDS {
        let begin = Spent::now();
        run()?;
        let spent = begin.since();
        best = Spent { cpu: best.cpu.min(spent.cpu), clock: best.clock.min(spent.clock) };
    }
    Ok(best)
}

/// Resident memory of this process, MB.
fn resident_mb() -> Result<f64, String> {
    let status = std::fs::read_to_string("/proc/self/status").map_err(|e| format!("/proc/self/status: {e}"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kb = line.and_then(|line| line.split_whitespace().next()).and_then(|word| word.parse::<f64>().ok());
    kb.map(|kb| kb / 1024.0).ok_or_else(|| "/proc/self/status: expected a line VmRSS".to_owned())
}
