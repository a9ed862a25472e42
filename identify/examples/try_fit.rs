use identify::{fit::*, layout::Layout, plants::*, score::*};
use model::effects::*;
fn main() {
    let p = find("silverbox").unwrap();
    let data = Table::read("/work/shared/data/silverbox/snls80mv.csv.gz".as_ref()).unwrap();
    let (problem, predicted) = analysis::sections(p, &data, None).unwrap();
    let keep: usize = std::env::var("KEEP").ok().and_then(|v| v.parse().ok()).unwrap_or(3);
    let problem = { let mut q = problem.clone(); q.stretches.truncate(keep); q.std.truncate(keep); q.steps.truncate(keep); q };
    let sets: Vec<(&str, Vec<&'static dyn Effect>, Vec<f64>)> = vec![
        ("cubic+offset", vec![&CubicStiffness, &ForceOffset], vec![3.9, -0.0054]),
        ("cubic+quad -", vec![&CubicStiffness, &QuadraticStiffness], vec![3.9, -0.5]),
        ("cubic+quad +", vec![&CubicStiffness, &QuadraticStiffness], vec![3.9, 0.5]),
        ("cubic+quad 2", vec![&CubicStiffness, &QuadraticStiffness], vec![3.9, 2.0]),
        ("cubic+offset+quad", vec![&CubicStiffness, &ForceOffset, &QuadraticStiffness], vec![3.9, -0.0054, 0.0]),
        ("cubic", vec![&CubicStiffness], vec![3.9]),
    ];
    for (name, effects, start) in sets {
        let mut layout = Layout::of_plant(p);
        layout.effects = effects.clone();
        let mut theta = vec![5.36e-6, 2.25e-4, 0.987];
        theta.extend(start);
        let f = fit(&problem, &layout, problem.point(theta), Effort { iterations: 40, tolerance: 1e-9, ..Effort::default() }).unwrap();
        let std = problem.std[0][0];
        print!("{name}: train {:.4} mV theta {:?}", 1e3 * std * (f.cost / problem.targets() as f64).sqrt(), f.point.theta);
        for s in &predicted {
            let r = &s.stretches[0];
            let y = p.rows(r, &layout, &f.point.theta, &[0.0; 2]).unwrap();
            let (mut q, mut n) = (0.0, 0);
            for i in 0..r.rows() { if r.measured[0][i].is_finite() { q += (r.measured[0][i] - y[i][0]).powi(2); n += 1; } }
            print!(" {}: {:.4}", s.name, 1e3 * (q / n as f64).sqrt());
        }
        println!();
        if name == "cubic" || name == "cubic+offset" {
            let scene = Scene::new(&problem, &f).unwrap();
            let d: Vec<Direction> = [&ForceOffset as &'static dyn Effect, &QuadraticStiffness, &AsymmetricCoulomb, &CoulombFriction, &QuadraticDrag, &CubicStiffness].iter().flat_map(|e| scene.directions(*e)).collect();
            let g = Gram::new(&d);
            for i in 0..d.len() { println!("   {} {:?} sq {:.3e} gain {:.0} cos {:?}", d[i].effect.header().id, d[i].start, d[i].square, d[i].gain(), (0..d.len()).map(|j| (g.cosine(i, j) * 1e3).round() / 1e3).collect::<Vec<_>>()); }
        }
    }
}
