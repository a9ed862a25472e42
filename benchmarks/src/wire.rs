//! Ticks for a benchmark of wires, and its times as rows of a table.

use rt_core::PERIOD_NS;
use rt_core::system::time::{monotonic_ns, sleep_until_ns};
use std::error::Error;

/// Calls `tick` with 0, 1, ... at 1 kHz from `start_ns` on. Ticks that the machine holds up by half a period are left out, as the loop
/// leaves them out: what was asked an instant before can't be answered yet.
pub fn ticks(
    start_ns: u64,
    count: u64,
    mut tick: impl FnMut(u64) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    for n in 0..count {
        let due_ns = start_ns + n * PERIOD_NS;
        sleep_until_ns(due_ns);
        // The first one begins what the others judge.
        if n == 0 || monotonic_ns() < due_ns + PERIOD_NS / 2 {
            tick(n)?;
        }
    }
    Ok(())
}

/// The table's head.
pub fn head() {
    println!("{:<44}{:>10}{:>10}{:>10}", "", "p50", "p99.9", "max");
}

/// Prints p50, p99.9 and max (us) of times in ns, with their ratios to another row's, which it gives back.
pub fn row(name: &str, times_ns: &mut [u64], against: Option<[f64; 3]>) -> [f64; 3] {
    times_ns.sort_unstable();
    let at = |share: f64| {
        let last = times_ns.len().saturating_sub(1);
        times_ns.get((share * last as f64).round() as usize).map_or(f64::NAN, |&ns| ns as f64 * 1e-3)
    };
    let figures = [at(0.5), at(0.999), at(1.0)];
    print!("{name:<44}{:>10.1}{:>10.1}{:>10.1}", figures[0], figures[1], figures[2]);
    match against {
        Some(of) => println!("   ratios {:.2} {:.2} {:.2}", figures[0] / of[0], figures[1] / of[1], figures[2] / of[2]),
        None => println!(),
    }
    figures
}
