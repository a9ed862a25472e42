fn main() {
    let a: Vec<String> = std::env::args().collect();
    tracing_subscriber::fmt().with_max_level(tracing::Level::INFO).with_writer(std::io::stderr).init();
    use identify::plants::*;
    let p = find(&a[1]).unwrap();
    let data = Table::read(a[2].as_ref()).unwrap();
    let v = a.get(3).map(|f| Table::read(f.as_ref()).unwrap());
    let t = std::time::Instant::now();
    let r = analysis::analyse(p, &data, v.as_ref(), &|s| eprintln!("{:.1} {s}", t.elapsed().as_secs_f64())).unwrap();
    println!("base {:?} {:?} cost {}", r.declared.point.theta, r.declared_std, r.declared.cost / r.problem.targets() as f64);
    println!("after {:?} {:?} {:?} cost {}", r.diagnosis.after.layout.names(), r.diagnosis.after.point.theta, r.after_std, r.diagnosis.after.cost / r.problem.targets() as f64);
    println!("std {:?} parts {:?} {:?}", r.problem.std[0], r.diagnosis.parts_before, r.diagnosis.parts_after);
    for s in &r.scored { println!("{s:?}"); }
    println!("{}", r.findings.to_json());
}
