//! A bypass valve whose armature travels at one speed, a law that the library lacks: the lag is named, or, without it, the balance found.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use common::{layout, problem, run};
use identify::diagnose::{Declared, Diagnosis, Verdict, diagnose_declared};
use identify::fit::{Effort, fit};
use model::Parameters;
use model::effects::{Balance, Effect, Header, Law, Parameter, find};
use model::port::{Port, PortKind, Rest};
use model::scalar::Scalar;

/// Opens and closes within `k[0]` seconds, evenly.
struct Armature;

impl Law for Armature {
    const HEADER: Header = Header {
        id: "armature",
        balance: Balance::Pump,
        ports: &[PortKind::Actuator],
        summary: "the bypass valve's armature travels at one speed",
        equation: "y' = 1/T towards the command",
        validity: "",
        measure: "",
        literature: "",
        parameters: &[Parameter { name: "T", unit: "s", lower: 1e-3, upper: 1.0, typical: 0.03, size: true }],
        states: 1,
        starts: &[&[0.03]],
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            let ahead = a.bypass_opening.value() - x[0].value();
            // it comes to rest within the last twentieth of its way
            dx[0] = S::constant((20.0 * ahead).clamp(-1.0, 1.0)) / k[0];
            a.bypass_opening = x[0];
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(f64::from(u8::from(rest.bypass_open)));
    }
}

const TRAVEL_S: f64 = 0.12;

fn diagnosed(library: &[&str]) -> Diagnosis {
    let truth = Parameters::example();
    let armature: &'static dyn Effect = &Armature;
    let problem = problem(&[7, 8, 9].map(|seed| run(&truth, vec![(armature, vec![TRAVEL_S])], 20.0, seed)));
    let layout = layout(&truth);
    let component = layout.vector_of(&truth);
    let base = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
    let library: Vec<&'static dyn Effect> = library.iter().map(|id| find(id).unwrap()).collect();
    let base = Declared { problem: &problem, fit: &base, component: &component };
    diagnose_declared(&library, &base, &|text| println!("{text}")).unwrap()
}

const OTHERS: [&str; 6] =
    ["brake_valve_lag", "cross_leakage", "pump_lag", "stribeck_friction", "trapped_air", "pressure_lag"];

#[test]
fn a_bypass_that_is_late_is_named_and_by_how_much() {
    let found = diagnosed(&[&OTHERS[..], &["bypass_valve_lag"]].concat());
    let names: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    assert_eq!((found.verdict, &names[..]), (Verdict::Attributed, &["bypass_valve_lag"][..]));
    for late_s in &found.effects[0].values[..2] {
        // the area between command and opening; a general form's dead time and lag make it up together
        assert!((late_s / (0.5 * TRAVEL_S) - 1.0).abs() < 0.5, "{late_s}");
    }
}

#[test]
fn without_the_name_it_is_found_in_the_pump_s_balance() {
    let found = diagnosed(&OTHERS);
    let balances: Vec<Balance> = found.effects.iter().map(|a| a.effect.header().balance).collect();
    assert_eq!((found.verdict, &balances[..]), (Verdict::Unrecognised, &[Balance::Pump][..]));
}
