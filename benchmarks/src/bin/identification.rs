//! Speed and accuracy of the simulation kernel, of its sensitivities, and of a whole identification.
//!
//! ```text
//! cargo run --release -p benchmarks --bin identification             # all
//! cargo run --release -p benchmarks --bin identification -- kernel   # kernel and sensitivities alone
//! ```
//!
//! | figure | what is measured |
//! |---|---|
//! | kernel | free run of `square_h`, `random_a` and `constant_flow` at 1 kHz output, one core: virtual over real time; largest deviation from the same with steps of 50 us, over each channel's range |
//! | sensitivities | the same with derivatives along 20 parameters and 3 initial values, over the plain run |
//! | identification | all experiments of the emulated rig, some 20 minutes: reading CSV, identifying, checks, validation, report |

use benchmarks::campaign::{draw, recorded};
use benchmarks::{Target, exit};
use drivers::emulated::Noise;
use identify::analysis::{Depth, analyse};
use identify::identification::Loaded;
use identify::layout::Layout;
use identify::predict::{linearise, predict_rows};
use identify::prepare::Stretch;
use identify::validate::prepare_run;
use model::Parameters;
use model::effects::EffectSet;
use model::integrate::Integrator;
use model::parameters::index;
use model::rec::{STATES, state};
use std::error::Error;
use std::process::ExitCode;
use std::time::Instant;

/// Times real time of the plain kernel.
const TARGET_KERNEL: Target = Target::AtLeast(2000.0);
/// Deviation from 50 us over the range.
const TARGET_ERROR: Target = Target::AtMost(1e-6);
/// Time with derivatives over time without.
const TARGET_SENSITIVITY: Target = Target::AtMost(8.0);
/// Seconds of a whole identification on two cores.
const TARGET_IDENTIFICATION: Target = Target::AtMost(10.0);
/// Each figure is the median of as many.
const ROUNDS: usize = 7;
/// Steps of the reference, s.
const REFERENCE_S: f64 = 5e-5;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let kernel_alone = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => false,
        ["kernel"] => true,
        _ => {
            eprintln!("expected `kernel` or nothing, got {arguments:?}");
            return ExitCode::from(2);
        }
    };
    exit(measure(kernel_alone))
}

fn measure(kernel_alone: bool) -> Result<bool, Box<dyn Error>> {
    let truth = draw(1);
    let (campaign, recordings) = recorded(&truth, Noise::default(), 1)?;
    let loaded = Loaded::from_recordings(campaign, recordings.clone());
    let mut reached = true;
    for name in ["square_h", "random_a", "constant_flow"] {
        let run = loaded.runs.iter().position(|r| r.entry.file.starts_with(name)).ok_or("a profile is missing")?;
        reached &= kernel(name, &prepare_run(&loaded, run)?.stretches[0], &truth)?;
    }
    if kernel_alone {
        return Ok(reached);
    }

    let dir = tempfile::tempdir()?;
    let mut campaign = loaded.campaign.clone();
    campaign.dir = dir.path().to_owned();
    for (entry, recording) in campaign.runs.iter_mut().zip(&recordings) {
        entry.file = entry.file.replace(".mcap", ".csv");
        recording.write_csv(&dir.path().join(&entry.file))?;
    }
    campaign.write_toml()?;
    let minutes: f64 = recordings.iter().filter_map(|r| r.time_s.last()).sum::<f64>() / 60.0;
    drop((loaded, recordings));
    let mut seconds = Vec::new();
    for _ in 0..3 {
        let begin = Instant::now();
        let loaded = Loaded::read(dir.path())?;
        let read = begin.elapsed().as_secs_f64();
        let analysis = analyse(&loaded, Depth::Identification, &|_| ())?;
        analysis.write(&dir.path().join("analysis"))?;
        seconds.push((begin.elapsed().as_secs_f64(), read));
    }
    seconds.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (whole, read) = seconds[seconds.len() / 2];
    println!(
        "identification of {minutes:.1} minutes on {} cores: {whole:.2} s, of which reading {read:.2} s   {}",
        rayon::current_num_threads(),
        TARGET_IDENTIFICATION.judge(whole)
    );
    Ok(reached & TARGET_IDENTIFICATION.reached_by(whole))
}

/// Median time of several runs, s.
fn timed<T>(mut run: impl FnMut() -> Result<T, Box<dyn Error>>) -> Result<(f64, T), Box<dyn Error>> {
    let mut seconds = Vec::new();
    let mut last = run()?;
    for _ in 0..ROUNDS {
        let begin = Instant::now();
        last = run()?;
        seconds.push(begin.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    Ok((seconds[ROUNDS / 2], last))
}

fn kernel(name: &str, stretch: &Stretch, truth: &Parameters) -> Result<bool, Box<dyn Error>> {
    let layout = Layout::base(truth);
    let theta = layout.vector_of(truth);
    let length_s = stretch.time_s[stretch.rows() - 1] - stretch.time_s[0];
    let (plain_s, rows) = timed(|| Ok(predict_rows(stretch, &layout, &theta, &[0.0; 3])?))?;
    let deviation = deviation(stretch, truth, &rows)?;

    // 20 parameters: inertia and gravity too
    let mut with = layout.clone();
    with.base.extend([index::J, index::G]);
    let theta = with.vector_of(truth);
    let (values_s, _) = timed(|| Ok(predict_rows(stretch, &with, &theta, &[0.0; 3])?))?;
    let (slopes_s, _) = timed(|| Ok(linearise(stretch, &with, &theta, &[0.0; 3])?))?;
    let speed = length_s / plain_s;
    let ratio = slopes_s / values_s;
    println!("{name}, {length_s:.0} s");
    println!("  kernel, times real time            {speed:>10.0}   {}", TARGET_KERNEL.judge(speed));
    println!("  deviation from 50 us over range    {deviation:>10.1e}   {}", TARGET_ERROR.judge(deviation));
    println!("  {} parameters over a plain run      {ratio:>10.2}   {}", with.len(), TARGET_SENSITIVITY.judge(ratio));
    Ok(TARGET_KERNEL.reached_by(speed) & TARGET_ERROR.reached_by(deviation) & TARGET_SENSITIVITY.reached_by(ratio))
}

/// Largest difference from the same run in steps of [`REFERENCE_S`], over each channel's range.
fn deviation(stretch: &Stretch, truth: &Parameters, rows: &[[f64; 5]]) -> Result<f64, Box<dyn Error>> {
    let k = truth.to_vector();
    let effects = EffectSet::none();
    let integrator = Integrator::new(REFERENCE_S);
    let mut x = vec![0.0; STATES];
    for (i, value) in
        [state::ANGLE, state::PRESSURE1, state::PRESSURE2].into_iter().zip(stretch.initial.iter().copied())
    {
        x[i] = value;
    }
    let mut most = [0.0f64; 3];
    let mut range = [(f64::INFINITY, f64::NEG_INFINITY); 3];
    for (i, row) in rows.iter().enumerate() {
        let exact = [x[state::ANGLE].to_degrees(), x[state::PRESSURE1], x[state::PRESSURE2]];
        for c in 0..3 {
            most[c] = most[c].max((row[c] - exact[c]).abs());
            range[c] = (range[c].0.min(exact[c]), range[c].1.max(exact[c]));
        }
        if i + 1 < stretch.rows() {
            let dt = stretch.time_s[i + 1] - stretch.time_s[i];
            integrator.advance(&stretch.input(i, dt), &k, &effects, stretch.time_s[i], dt, &mut x)?;
        }
    }
    Ok((0..3).map(|c| most[c] / (range[c].1 - range[c].0)).fold(0.0, f64::max))
}
