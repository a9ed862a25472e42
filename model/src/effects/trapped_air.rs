//! Air pockets in the chambers, which the paper calls impossible to avoid.

use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{AMBIENT_BAR, Port, PortKind, Rest};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
pub struct TrappedAir;

impl Law for TrappedAir {
    const HEADER: Header = Header {
        id: "trapped_air",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "air pockets add capacity at low pressure",
        equation: "C_hi += V_ai*p_amb/p_i^2: isothermal air of volume V_ai at ambient pressure in chamber i = 1, 2",
        validity: "isothermal, no air goes into solution",
        measure: "clamp steps of both chambers down to ambient pressure",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 2 (bulk modulus with entrapped air); paper, sec. 3.2",
        parameters: &[
            Parameter { name: "V_a1", unit: "ml", lower: 0.0, upper: 60.0, typical: 0.5, size: true },
            Parameter { name: "V_a2", unit: "ml", lower: 0.0, upper: 60.0, typical: 0.5, size: true },
        ],
        states: 0,
        starts: &[&[0.2, 0.0], &[0.0, 0.2], &[0.2, 0.2], &[4.0, 0.5], &[0.5, 4.0]],
        passive: true,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Dissolving,
        neutral: &[0.0, 10.0],
        starts: &[&[0.1, 10.0], &[0.1, 1.0]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, volume) in k.iter().enumerate() {
                let p = h.pressure_bar[i];
                h.capacity_ml_bar[i] += *volume * AMBIENT_BAR / (p * p);
            }
        }
    }
}

/// Air that the oil takes up under pressure and gives back, an empirical uptake: by Henry's law what dissolves goes with the volume of the oil, which this
/// effect does not know. Passive: it dissolves at higher pressure than it comes out at. It closes the oil of every cycle as long as no more dissolves than
/// there is.
struct Dissolving;

/// Share of the air over which its end is rounded off, to both sides.
const ROUNDED: f64 = 0.05;

impl Law for Dissolving {
    const HEADER: Header = Header {
        equation: "of the air V_ai the part x_i is in solution, tau*x_i' = V_ai*min(1, h*(p_i - p_amb)) - x_i (the share h of it per bar, an empirical uptake; the corner rounded between shares of 0.95 and 1.05), the rest n_i = V_ai - x_i is free: C_hi += n_i*p_amb/p_i^2, and x_i'*p_amb/p_i flows out of chamber i = 1, 2; at rest x_i = V_ai*min(1, h*(p_i - p_amb))",
        validity: "isothermal; all air is free at ambient pressure",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 2; Zhou, Vacca, Manhartsgruber, J. Fluids Eng. 135, 2013 (release and solution of air)",
        parameters: &[
            TrappedAir::HEADER.parameters[0],
            TrappedAir::HEADER.parameters[1],
            Parameter { name: "h", unit: "1/bar", lower: 0.0, upper: 1.0, typical: 0.1, size: false },
            Parameter { name: "tau", unit: "s", lower: 0.1, upper: 300.0, typical: 10.0, size: false },
        ],
        states: 2,
        starts: &[&[0.5, 0.5, 0.1, 10.0]],
        ..TrappedAir::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for i in 0..2 {
                let p = h.pressure_bar[i];
                let rate = (dissolved(k[i], k[2], p - AMBIENT_BAR) - x[i]) / k[3];
                dx[i] = rate;
                h.capacity_ml_bar[i] += (k[i] - x[i]).at_least(0.0) * AMBIENT_BAR / (p * p);
                h.flow_ml_s[i] -= rate * AMBIENT_BAR / p;
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for (chamber, x) in x.iter_mut().enumerate() {
            *x = dissolved(k[chamber], k[2], rest.gauge_bar(chamber));
        }
    }
}

/// What is in solution in equilibrium of a volume of air, of which a bar takes up the share `per_bar`: never more than all.
fn dissolved<S: Scalar>(air_ml: S, per_bar: S, gauge_bar: S) -> S {
    let beyond = per_bar * gauge_bar - (1.0 - ROUNDED);
    if beyond.value() <= 0.0 {
        air_ml * per_bar * gauge_bar
    } else if beyond.value() < 2.0 * ROUNDED {
        air_ml * (per_bar * gauge_bar - beyond * beyond / (4.0 * ROUNDED))
    } else {
        air_ml
    }
}
