//! A small fake rig: the reference model by explicit Euler steps, without noise. It is a stand-in to play scripts against,
//! not the bench's emulated device.

use rt_core::{ControlledPressure, Fixture, Measurement, Reference, Step, Target, Tick};

#[derive(Clone, Copy)]
pub struct Parameters {
    pub m: [f64; 3],
    pub h: [f64; 3],
    pub a1: f64,
    pub v: [f64; 2],
    pub f: [f64; 4],
    pub l: [f64; 5],
    pub inertia: f64,
    pub gravity_nm: f64,
    pub bypass_ml_s_bar: f64,
}

pub const EXAMPLE: Parameters = Parameters {
    m: [-1.6, -4.0, 6.8],
    h: [7.6, -1.5, 0.9],
    a1: 0.008,
    v: [-9.0, 68.0],
    f: [0.61, 0.005, -0.25, -0.60],
    l: [1.2, 2.4, 1.1, 57.4, 0.02],
    inertia: 0.085,
    gravity_nm: 4.0,
    bypass_ml_s_bar: 40.0,
};

/// The example and its neighbours: each parameter group stronger and weaker, about as far as rigs of one make differ.
pub fn plausible_rigs() -> Vec<(&'static str, Parameters)> {
    let e = EXAMPLE;
    vec![
        ("example", e),
        ("strong pump", Parameters { f: [0.63, 0.0055, -0.22, -0.55], ..e }),
        ("weak pump", Parameters { f: [0.58, 0.0045, -0.30, -0.64], ..e }),
        ("stiff chambers", Parameters { h: [6.3, -1.5, 0.75], a1: 0.0092, v: [-10.5, 76.0], ..e }),
        ("soft chambers", Parameters { h: [9.5, -1.6, 1.0], a1: 0.0066, v: [-8.0, 61.0], ..e }),
        ("stiff lever", Parameters { m: [-1.9, -4.8, 6.2], l: [1.4, 2.9, 1.3, 79.0, 0.017], ..e }),
        ("light lever", Parameters { m: [-1.3, -3.5, 7.8], l: [1.0, 1.9, 0.9, 44.0, 0.0215], ..e }),
    ]
}

pub struct FakeRig {
    p: Parameters,
    vertical: bool,
    phi: f64,
    omega: f64,
    pressure_bar: [f64; 2],
    bench: bool,
    clamped: bool,
}

impl FakeRig {
    pub fn new(p: Parameters, vertical: bool, start: Fixture, fill_bar: f64) -> Self {
        let angle_deg = match start {
            Fixture::Clamped { angle_deg } | Fixture::Filled { angle_deg, .. } => angle_deg,
            _ => 0.0,
        };
        let bench = matches!(start, Fixture::PumpBench { .. });
        FakeRig {
            p,
            vertical,
            phi: angle_deg.to_radians(),
            omega: 0.0,
            pressure_bar: [fill_bar; 2],
            bench,
            clamped: matches!(start, Fixture::Clamped { .. }),
        }
    }

    pub fn measure(&self) -> Measurement {
        let torque_nm = if self.clamped { self.torque(self.phi) } else { f64::NAN };
        let angle_deg = if self.bench { f64::NAN } else { self.phi.to_degrees() };
        Measurement {
            angle_deg,
            pressure1_bar: self.pressure_bar[0],
            pressure2_bar: self.pressure_bar[1],
            torque_nm,
            ..Measurement::NONE
        }
    }

    fn torque(&self, phi: f64) -> f64 {
        let dp = self.pressure_bar[0] - self.pressure_bar[1];
        (self.p.m[0] * dp.abs() + self.p.m[1]) * phi + self.p.m[2] * dp
    }

    /// An ideal controller: the exact inverse of the pump's characteristic, within the amplifier's range; angle and
    /// pressures by a flow in proportion to what is missing.
    fn voltage(&self, target: Target, u_max_v: f64) -> f64 {
        let [f1, f2, f3, f4] = self.p.f;
        let [p1, p2] = self.pressure_bar;
        let flow_ml_s = match target {
            Target::VoltageV(v) => return v,
            Target::FlowMlS(q) => q,
            Target::AngleDeg { angle_deg, velocity_deg_s } => {
                let missing_deg = angle_deg - self.phi.to_degrees();
                self.p.v[1] * (velocity_deg_s + 3.0 * missing_deg).to_radians()
            }
            Target::PressureBar { of: ControlledPressure::Chamber1, bar } => 100.0 * (bar - p1),
            Target::PressureBar { of: ControlledPressure::Chamber2, bar } => -100.0 * (bar - p2),
            Target::PressureBar { of: ControlledPressure::Difference, bar } => 50.0 * (bar - p1 + p2),
        };
        let dp = p1 - p2;
        let driven = flow_ml_s - f3 * dp;
        let sign = driven.signum();
        (sign * (driven.abs() - f4) / (f1 + sign * f2 * dp)).clamp(-u_max_v, u_max_v)
    }

    pub fn advance(&mut self, step: &Step, u_max_v: f64) -> f64 {
        let u = self.voltage(step.target, u_max_v);
        let mut released_ml_s = 0.0;
        let mut led_to = None;
        self.bench = false;
        self.clamped = false;
        match step.fixture {
            Fixture::Free => {}
            Fixture::Clamped { angle_deg } => {
                self.clamped = true;
                led_to = Some(angle_deg);
            }
            Fixture::Driven { angle_deg } => led_to = Some(angle_deg),
            Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => {
                (self.phi, self.omega) = (angle_deg.to_radians(), 0.0);
                self.pressure_bar = [pressure1_bar, pressure2_bar];
                led_to = Some(angle_deg);
            }
            Fixture::Released { angle_deg, flow_ml_s } => {
                released_ml_s = flow_ml_s;
                led_to = Some(angle_deg);
            }
            Fixture::PumpBench { pressure1_bar, pressure2_bar } => {
                self.bench = true;
                self.pressure_bar = [pressure1_bar, pressure2_bar];
                return u;
            }
        }
        const SUBSTEPS: usize = 8;
        let dt = 1e-3 / SUBSTEPS as f64;
        if let Some(angle_deg) = led_to {
            self.omega = (angle_deg.to_radians() - self.phi) / 1e-3;
        }
        for _ in 0..SUBSTEPS {
            let [p1, p2] = self.pressure_bar;
            let dp = p1 - p2;
            let [f1, f2, f3, f4] = self.p.f;
            let pump = f3 * dp + u.signum() * ((f1 * u.abs() + f4 + f2 * u * dp).max(0.0)) * f64::from(u != 0.0);
            let mut q = if step.brake_open { pump } else { 0.0 };
            if step.bypass_open {
                q -= self.p.bypass_ml_s_bar * dp;
            }
            let capacity = |phi: f64, p: f64| {
                (-self.p.a1 * phi.to_degrees()).exp() * (self.p.h[0] * p.powf(self.p.h[1]) + self.p.h[2])
            };
            let rate1 =
                (q - released_ml_s - (self.p.v[0] * self.phi + self.p.v[1]) * self.omega) / capacity(self.phi, p1);
            let rate2 = (-q - (self.p.v[0] * self.phi - self.p.v[1]) * self.omega) / capacity(-self.phi, p2);
            if led_to.is_none() {
                let w = self.omega.abs();
                let [l1, l2, l3, l4, a] = self.p.l;
                let loss = if w < a { l4 * w } else { l1 * w * w + l2 * w + l3 }.copysign(self.omega);
                let load = if self.vertical { self.p.gravity_nm * self.phi.sin() } else { 0.0 };
                self.omega += dt * (self.torque(self.phi) - loss - load) / self.p.inertia;
            }
            self.phi += dt * self.omega;
            self.pressure_bar = [p1 + dt * rate1, p2 + dt * rate2];
        }
        u
    }
}

/// One tick of a played run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub measured: Measurement,
    pub step: Step,
    pub voltage_v: f64,
}

/// Plays a script to its last tick; panics where it does not end within `limit` ticks.
pub fn play(reference: &mut impl Reference, rig: &mut FakeRig, u_max_v: f64, limit: u64) -> Vec<Row> {
    let mut rows = Vec::new();
    for k in 0..limit {
        let measured = rig.measure();
        let step = reference.step(Tick::at(k), &measured);
        let voltage_v = rig.advance(&step, u_max_v);
        rows.push(Row { measured, step, voltage_v });
        if step.last {
            return rows;
        }
    }
    panic!("the run did not end within {limit} ticks");
}
