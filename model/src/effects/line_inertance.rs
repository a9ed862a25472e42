//! Inertia of the oil in the line between pump and chambers, which the paper's sec. 5 suspects behind its oscillations.

use super::lag::{SHORTEST_S, first_order, second_order};
use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{LinePort, Port, PortKind};
use crate::scalar::Scalar;

/// See [`Law::HEADER`].
///
/// The pump sees dp + I*q'. Its flow falls by `slip` per bar, so q = Q_p - slip*I*q': the line's flow follows with the time
/// constant I*slip, which changes with the voltage. The bypass joins the chambers behind the line, so that they equalise at once.
pub struct LineInertance;

impl Law for LineInertance {
    const HEADER: Header = Header {
        id: "line_inertance",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "the oil in the line between pump and chambers has inertia",
        equation: "I*slip*q' = Q_p - q, slip = -dQ_p/d(dp); Q = q - k_b*dp goes into the chambers; q = 0 where the brake is closed; slip is 0.02 ml/(s bar) at least",
        validity: "incompressible oil in a short line, I = rho*length/area: 2e-4 bar s2/ml for 0.3 m of 4 mm bore, 0.02 for 1 m of 0.7 mm; a closing valve stops it at once; the bypass is at the chambers; a pump that slips less than the least slip lags by I times that, and I*slip below 1 ms is blended into none",
        measure: "reverse the voltage with the lever clamped and watch the pressures at 1 kHz or more",
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 3 (transients in conduits); paper, sec. 5",
        parameters: &[Parameter { name: "I", unit: "bar s2/ml", lower: 0.0, upper: 3.0, typical: 0.02, size: true }],
        states: 1,
        starts: &[&[0.005], &[0.03], &[0.1], &[0.4]],
        passive: false,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Compliant,
        neutral: &[0.0, 0.0],
        starts: &[&[1e-3, 0.0], &[5e-3, 0.0], &[0.02, 0.0], &[1e-3, 1.0]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let behind = l.bypass_ml_s_bar * -l.dp_bar();
            if l.opening.value() > 0.0 {
                let (rate, q) = first_order(k[0] * l.slip_ml_s_bar, l.flow_ml_s - behind, x[0]);
                dx[0] = rate;
                l.flow_ml_s = q + behind;
            } else {
                dx[0] = -x[0] / SHORTEST_S;
            }
        }
    }
}

/// A line with oil to compress at the pump's end, and a bypass at either end of it: then what the pump delivers swings into the chambers.
struct Compliant;

impl Law for Compliant {
    const HEADER: Header = Header {
        equation: "C*(p - dp)' = Q_p + slip*dp - slip*p - s*k_b*p - q at the pump's end of the line, p the pressure difference there; I*q' = p - dp; Q = q - (1 - s)*k_b*dp",
        validity: "one node of capacity at the pump; a swing of w beyond 1000 rad/s is slowed down to that; a closing valve stops the line's oil at once where nothing passes beside it",
        parameters: &[
            LineInertance::HEADER.parameters[0],
            Parameter { name: "C", unit: "ml/bar", lower: 0.0, upper: 1.0, typical: 5e-3, size: false },
            Parameter { name: "s", unit: "1", lower: 0.0, upper: 1.0, typical: 0.5, size: false },
        ],
        states: 2,
        // 4 to 24 Hz, which a fit does not leave by itself
        starts: &[
            &[0.08, 0.02, 0.0],
            &[0.04, 0.02, 0.0],
            &[0.02, 0.02, 0.0],
            &[0.01, 0.02, 0.0],
            &[5e-3, 0.02, 0.0],
            &[2e-3, 0.02, 0.0],
            &[0.1, 0.0, 1.0],
        ],
        ..LineInertance::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            before_and_behind(k, x, dx, l);
        }
    }
}

/// The share `k[2]` of the bypass is at the pump's end of the line, the rest at the chambers'. `x`: the line's flow, and how far the pump's pressure
/// difference is above the chambers'.
fn before_and_behind<S: Scalar>(k: &[S], x: &[S], dx: &mut [S], l: &mut LinePort<S>) {
    let before_ml_s_bar = l.bypass_ml_s_bar * k[2];
    let behind = (l.bypass_ml_s_bar - before_ml_s_bar) * -l.dp_bar();
    if !l.open || (l.opening.value() <= 0.0 && before_ml_s_bar.value() <= 0.0) {
        (dx[0], dx[1]) = (-x[0] / SHORTEST_S, -x[1] / SHORTEST_S);
        return;
    }
    // what passes at the pump's end where that is at the chambers' pressure, and how that falls with the pressure there
    let delivered = l.flow_ml_s - behind;
    let slip = l.slip_ml_s_bar + before_ml_s_bar;
    let ([rate, drive_rate], q) = second_order(k[0] * slip, k[1] / slip, delivered, [x[0], x[1] * slip]);
    (dx[0], dx[1]) = (rate, drive_rate / slip);
    l.flow_ml_s = q + behind;
}
