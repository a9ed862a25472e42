//! What valves that take their time have in common, whichever they are.

use std::marker::PhantomData;

use super::lag::first_order;
use super::{Balance, Header, Law, Parameter, Refined};
use crate::port::{ActuatorPort, Port, PortKind, Rest};
use crate::scalar::Scalar;

/// A valve that may be late.
pub(super) trait Valve: Sync + 'static {
    /// [`Header::id`] of its lag.
    const ID: &'static str;
    /// [`Header::summary`].
    const SUMMARY: &'static str;
    /// [`Header::equation`] of the lag, and of the general form.
    const EQUATIONS: [&'static str; 2];
    /// [`Header::measure`].
    const MEASURE: &'static str;
    /// Its opening, 0 closed to 1 open: the command, which the lag replaces.
    fn opening<S>(port: &mut ActuatorPort<S>) -> &mut S;
    /// It is commanded open at rest.
    fn is_open<S>(rest: &Rest<S>) -> bool;
}

/// A valve's opening follows its command with a first-order lag.
pub struct Late<V>(PhantomData<V>);

impl<V> Late<V> {
    pub(super) const EFFECT: Self = Late(PhantomData);
}

impl<V: Valve> Law for Late<V> {
    const HEADER: Header = Header {
        id: V::ID,
        balance: Balance::Pump,
        ports: &[PortKind::Actuator],
        summary: V::SUMMARY,
        equation: V::EQUATIONS[0],
        validity: "first-order stand-in for coil delay and travel of the armature; flow proportional to the opening; time constants below 1 ms are blended into none",
        measure: V::MEASURE,
        literature: "Merritt, Hydraulic Control Systems, 1967, ch. 5 (valve dynamics)",
        parameters: &PARAMETERS,
        states: 1,
        starts: &[&[0.01, 0.01], &[0.02, 0.0], &[0.0, 0.02], &[0.1, 0.1]],
        passive: false,
    };
    const REFINED: Option<Refined> = Some(Refined {
        effect: &Overlapped::<V>(PhantomData),
        neutral: &[0.0, 0.0],
        starts: &[&[0.1, 0.0], &[0.3, 0.0], &[0.45, 0.0], &[0.0, 0.7]],
        away: &[],
        screened: &[],
    });

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            let opening = V::opening(a);
            (dx[0], *opening) = lag([k[0], k[1]], *opening, x[0]);
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x[0] = S::constant(f64::from(u8::from(V::is_open(rest))));
    }
}

const PARAMETERS: [Parameter; 2] = [
    Parameter { name: "tau_open", unit: "s", lower: 0.0, upper: 1.0, typical: 0.01, size: true },
    Parameter { name: "tau_close", unit: "s", lower: 0.0, upper: 1.0, typical: 0.01, size: true },
];

/// An armature that has to travel before oil flows, and that has opened all when it has not yet arrived: from a first-order lag to a dead time. It
/// may go most of its way at one speed.
struct Overlapped<V>(PhantomData<V>);

impl<V: Valve> Law for Overlapped<V> {
    const HEADER: Header = Header {
        equation: V::EQUATIONS[1],
        validity: "overlap alike on both sides; flow proportional to the opening",
        parameters: &[
            PARAMETERS[0],
            PARAMETERS[1],
            Parameter { name: "s", unit: "1", lower: 0.0, upper: 0.48, typical: 0.2, size: false },
            Parameter { name: "e", unit: "1", lower: 0.0, upper: 0.8, typical: 0.5, size: false },
        ],
        starts: &[&[0.02, 0.02, 0.3, 0.0]],
        ..Late::<V>::HEADER
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Actuator(a) = port {
            let opening = V::opening(a);
            let way;
            (dx[0], way) = armature([k[0], k[1]], k[3], *opening, x[0]);
            *opening = overlapped(way, k[2]);
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        Late::<V>::EFFECT.rest(&k[..2], rest, x);
    }
}

/// A way that takes `tau_s` (to open, to close) to follow its command, with itself as `state`: (derivative of the state, the way).
#[inline(always)]
fn lag<S: Scalar>(tau_s: [S; 2], command: S, state: S) -> (S, S) {
    let [opens, closes] = tau_s;
    first_order(if command.value() > state.value() { opens } else { closes }, command, state)
}

/// The same of an armature that goes the share `even` of its way at one speed and the rest as a lag; `tau_s` is the mean delay whatever that share is.
#[inline(always)]
fn armature<S: Scalar>(tau_s: [S; 2], even: S, command: S, state: S) -> (S, S) {
    // from a distance r on as a lag of tau*2r/(1 + r^2): its even part takes (1 - r)/r of that, at a mean distance of (1 + r)/2
    let r = S::constant(1.0) - even;
    let shorter = r * 2.0 / (r * r + 1.0);
    let (rate, way) = lag(tau_s.map(|tau| tau * shorter), command, state);
    let ahead = (command - state).abs();
    (if ahead.value() > r.value() { rate * r / ahead } else { rate }, way)
}

/// Opening of a valve whose armature has gone this share of its way, with an overlap of the share `s` at both ends of it: (way - s)/(1 - 2*s),
/// from 0 to 1.
#[inline(always)]
fn overlapped<S: Scalar>(way: S, s: S) -> S {
    let one = S::constant(1.0);
    let opening = (way - s) / (one - s * 2.0);
    one - (one - opening.at_least(0.0)).at_least(0.0)
}
