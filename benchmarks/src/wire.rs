//! Times of wires as rows of a table.

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
