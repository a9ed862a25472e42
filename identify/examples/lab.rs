use identify::identification::*;
use std::time::Instant;
fn main() {
    tracing_subscriber::fmt()
        .with_env_filter(std::env::var("RUST_LOG").unwrap_or("info".into()))
        .with_writer(std::io::stderr)
        .init();
    for dir in std::env::args().skip(1) {
        let t0 = Instant::now();
        let loaded = Loaded::read(dir.as_ref()).unwrap();
        eprintln!("read {:?}", t0.elapsed());
        let id = identify(&loaded, &|s| eprintln!("{s} {:?}", t0.elapsed())).unwrap();
        eprintln!("targets {} cost {} ", id.problem.targets(), id.fit.cost);
        println!("{:?}", id.component);
        println!("{:?}", id.points.loss);
        println!("{dir} chi2/n {:.4}", id.fit.cost / id.problem.targets() as f64);
        if std::env::var("SCORE").is_ok() {
            let t = Instant::now();
            let scene = identify::score::Scene::new(&id.problem, &id.fit).unwrap();
            let mut all = Vec::new();
            for e in model::effects::LIBRARY {
                let d = scene.directions(*e);
                all.extend(d);
            }
            let gram = identify::score::Gram::new(&all);
            println!(
                "score took {:?}, residual {}",
                t.elapsed(),
                identify::score::dot(&scene.residual, &scene.residual)
            );
            let mut lines = Vec::new();
            for e in model::effects::LIBRARY {
                let idx: Vec<usize> = (0..all.len()).filter(|&i| all[i].effect.header().id == e.header().id).collect();
                lines.push((
                    gram.gain(&idx),
                    format!(
                        "{:22} {:?}",
                        e.header().id,
                        idx.iter().map(|&i| (all[i].scale(), all[i].gain())).collect::<Vec<_>>()
                    ),
                ));
            }
            lines.sort_by(|a, b| b.0.total_cmp(&a.0));
            for (g, l) in lines {
                println!("   {g:14.1} {l}");
            }
        }
        if std::env::var("DIAG").is_ok() {
            let d = identify::diagnose::diagnose(&id, &|s| eprintln!("{s} {:?}", t0.elapsed())).unwrap();
            println!(
                "VERDICT {dir} {:?} explained {:.4} left {:.3} before {:.3} time {:?}",
                d.verdict,
                d.explained,
                identify::misfit::largest(&d.parts_after),
                identify::misfit::largest(&d.parts_before),
                t0.elapsed()
            );
            for e in &d.effects {
                println!(
                    "   {} {:.3} {:?} {:?} +- {:?}",
                    e.effect.header().id,
                    e.probability,
                    e.equivalent,
                    e.values,
                    e.std
                );
            }
            println!(
                "   ranking {:?}",
                d.ranking.iter().map(|r| format!("{} {:.3}", r.id, r.probability)).collect::<Vec<_>>()
            );
            println!("   balances {:?} next {:?}", d.balances, d.next_experiment);
        }
        let truth: serde_json::Value =
            std::fs::read_to_string(format!("{}/../truths/{}.json", dir, dir.rsplit('/').next().unwrap()))
                .ok()
                .and_then(|t| serde_json::from_str(&t).ok())
                .unwrap_or_default();
        for ((n, v), s) in id.fit.layout.names().iter().zip(&id.fit.point.theta).zip(&id.std) {
            let mut tv = f64::NAN;
            if let Some(b) = truth["base"].as_object() {
                for g in b.values() {
                    if let Some(x) = g[n].as_f64() {
                        tv = x;
                    }
                }
            }
            println!("  {n:8} {v:12.6} +- {s:10.6} truth {tv:12.6} z {:6.2}", (v - tv) / s);
        }
        println!("{:?}", id.undetermined);
        let res = id.problem.residuals(&id.fit.layout, &id.fit.point).unwrap();
        if std::env::var("DUMP").is_ok() {
            for (n, s) in id.problem.stretches.iter().enumerate() {
                if s.protocol == recordings::Protocol::TorqueMap {
                    for (t, r) in s.targets.iter().zip(&res[n]) {
                        println!("DUMP {} {} {} {}", t.time_s, t.channel as usize, r, t.measured);
                    }
                }
            }
        }
        let mut per = std::collections::BTreeMap::<(usize, usize), (f64, f64, usize)>::new();
        for (n, s) in id.problem.stretches.iter().enumerate() {
            let mut last = [f64::NAN; 5];
            for (t, r) in s.targets.iter().zip(&res[n]) {
                let e = per.entry((s.run, t.channel as usize)).or_default();
                e.0 += r * r;
                e.2 += 1;
                if last[t.channel as usize].is_finite() {
                    e.1 += r * last[t.channel as usize];
                }
                last[t.channel as usize] = *r;
            }
        }
        for ((run, c), (a, b, n)) in per {
            println!(
                "   {:20} ch {c} var {:.3} struct {:.4} n {n} std {:.5}",
                loaded.runs[run].entry.file,
                a / n as f64,
                b / n as f64,
                id.problem.std[id.problem.stretches.iter().position(|s| s.run == run).unwrap()][c]
            );
        }
    }
}
