//! Turns a profile's target into a voltage.
//!
//! | target | answer | needs |
//! |---|---|---|
//! | voltage | itself | |
//! | flow | eq. (10) solved for the voltage at the measured pressure difference: [`constant_flow`] | a pump |
//! | pressure | PI by flow around a chamber's pressure or their difference: [`pressure`] | a model |
//! | angle | PI by flow around the angle of the free lever: [`angle`] | a model |
//!
//! The law of the closed loops and its gains stand in [`pi`], what the model contributes in [`feed_forward`], what its effects do there
//! in [`effects`]. When the kind of
//! target changes within a run, the new loop begins with the flow that acts and an empty integrator.

mod angle;
mod closed;
mod constant_flow;
mod effects;
mod feed_forward;
mod pi;
mod pressure;
mod seen;
mod settings;

pub use constant_flow::voltage_for_flow;
pub use effects::KnownEffects;
pub use settings::{ANGLE_BANDWIDTH_MAX_SHARE, ControllerError, PRESSURE_BANDWIDTH_MAX_HZ, Settings};

use closed::{ClosedLoops, Goal};
use model::parameters::{COUNT, Pump};
use model::{ModelFile, Parameters};
use rt_core::{Controller, Fixture, Measurement, Step, Target, Tick};
use seen::Seen;

/// Serves every target that its pump or model allows; any other is answered with NaN, which the supervisor takes for
/// what it is: no valid command.
///
/// Where a measurement is missing, the last one (flow) or the last voltage (angle, pressure) is held, 0 V before the
/// first; how long that may go on is the supervisor's to say.
#[derive(Clone, Debug)]
pub struct PumpController {
    pump: Option<Pump>,
    loops: Option<ClosedLoops>,
    /// Of the model, with its parameters.
    effects: (KnownEffects, [f64; COUNT]),
    seen: Seen,
    /// The last answer that was a number, V.
    acting_v: f64,
}

impl PumpController {
    /// Open loop only.
    pub fn open_loop() -> Self {
        let effects = (KnownEffects::none(), Parameters::example().to_vector());
        PumpController { pump: None, loops: None, effects, seen: Seen::NOTHING, acting_v: 0.0 }
    }

    /// Flow targets too, with this pump from a measured pump map.
    pub fn with_pump(pump: Pump) -> Self {
        PumpController { pump: Some(pump), ..Self::open_loop() }
    }

    /// Every target, with the identified model of the rig.
    ///
    /// # Errors
    /// Settings out of range; a model that can't be inverted.
    pub fn with_model(parameters: &Parameters, settings: Settings) -> Result<Self, ControllerError> {
        Self::with_effects(&ModelFile::plain(*parameters), settings)
    }

    /// The same with the effects that the model carries, as far as they have no memory ([`effects`]).
    ///
    /// # Errors
    /// As there.
    pub fn with_effects(model: &ModelFile, settings: Settings) -> Result<Self, ControllerError> {
        let (parameters, effects) = (&model.parameters, KnownEffects::of(model));
        let loops = ClosedLoops::new(parameters, effects.clone(), settings)?;
        let effects = (effects, parameters.to_vector());
        Ok(PumpController { loops: Some(loops), effects, ..Self::with_pump(parameters.pump) })
    }

    fn open_loops(&mut self) {
        if let Some(loops) = &mut self.loops {
            loops.open();
        }
    }

    fn flow_voltage_v(&self, now: Tick, flow_ml_s: f64) -> f64 {
        let (effects, k) = &self.effects;
        let seen = effects.corrected(now.seconds(), &self.seen);
        let dp_bar = seen.dp_bar();
        match &self.pump {
            None => f64::NAN,
            Some(_) if !dp_bar.is_finite() => self.acting_v,
            Some(pump) => {
                let inverse = |flow_ml_s| voltage_for_flow(pump, flow_ml_s, dp_bar);
                effects.voltage_v(k, now.seconds(), flow_ml_s, seen.pressure_bar(), inverse)
            }
        }
    }

    fn closed_voltage_v(&mut self, now: Tick, measured: &Measurement, step: &Step, goal: Goal) -> f64 {
        let Some(loops) = &mut self.loops else { return f64::NAN };
        let reachable = match goal {
            Goal::Angle { .. } => step.fixture == Fixture::Free,
            Goal::Pressure { .. } => !matches!(step.fixture, Fixture::PumpBench { .. }),
        };
        if !reachable {
            return f64::NAN;
        }
        if !step.brake_open || step.bypass_open {
            // The pump reaches nothing: it rests, and nothing is learnt from that.
            loops.open();
            return 0.0;
        }
        let seen = self.effects.0.corrected(now.seconds(), &self.seen);
        loops.voltage_v(now, measured, &seen, goal, self.acting_v)
    }
}

impl Controller for PumpController {
    fn begin_run(&mut self) {
        self.seen = Seen::NOTHING;
        self.acting_v = 0.0;
        self.open_loops();
    }

    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        self.seen.update(measured);
        let voltage_v = match step.target {
            Target::VoltageV(voltage_v) => {
                self.open_loops();
                voltage_v
            }
            Target::FlowMlS(flow_ml_s) => {
                self.open_loops();
                self.flow_voltage_v(now, flow_ml_s)
            }
            Target::PressureBar { of, bar } => self.closed_voltage_v(now, measured, step, Goal::Pressure { of, bar }),
            Target::AngleDeg { angle_deg, velocity_deg_s } => {
                self.closed_voltage_v(now, measured, step, Goal::Angle { angle_deg, velocity_deg_s })
            }
        };
        if voltage_v.is_finite() {
            self.acting_v = voltage_v;
        }
        voltage_v
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rt_core::{ControlledPressure, Input};

    fn step(target: Target) -> Step {
        Step {
            target,
            brake_open: true,
            bypass_open: false,
            fixture: Fixture::Free,
            segment: 0,
            index: 0,
            last: false,
            waiting: None,
            hands_on: false,
        }
    }

    fn measured(angle_deg: f64, pressure1_bar: f64, pressure2_bar: f64) -> Measurement {
        Measurement { angle_deg, pressure1_bar, pressure2_bar, ..Measurement::NONE }
    }

    fn with_model() -> PumpController {
        PumpController::with_model(&Parameters::example(), Settings::default()).expect("a sound model")
    }

    const ANGLE: Target = Target::AngleDeg { angle_deg: 10.0, velocity_deg_s: 0.0 };
    const PRESSURE: Target = Target::PressureBar { of: ControlledPressure::Difference, bar: 1.0 };

    #[test]
    fn a_target_without_its_model_is_no_command() {
        let (now, here) = (Tick::at(0), measured(0.0, 2.0, 2.0));
        let answer = |mut controller: PumpController, target| controller.control(now, &here, &step(target));
        assert_eq!(answer(PumpController::open_loop(), Target::VoltageV(-7.5)), -7.5);
        assert!(answer(PumpController::open_loop(), Target::FlowMlS(3.0)).is_nan());
        let pump = Parameters::example().pump;
        assert!(answer(PumpController::with_pump(pump), Target::FlowMlS(3.0)).is_finite());
        for target in [ANGLE, PRESSURE] {
            assert!(answer(PumpController::with_pump(pump), target).is_nan());
            assert!(answer(with_model(), target).is_finite());
        }
    }

    #[test]
    fn a_goal_that_the_pump_cannot_reach_is_no_command() {
        let (now, here) = (Tick::at(0), measured(0.0, 2.0, 2.0));
        let held = Fixture::Clamped { angle_deg: 0.0 };
        let bench = Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 2.0 };
        let answer = |target, fixture| with_model().control(now, &here, &Step { fixture, ..step(target) });
        assert!(answer(ANGLE, held).is_nan(), "the angle of a clamped lever");
        assert!(answer(PRESSURE, held).is_finite());
        assert!(answer(PRESSURE, bench).is_nan(), "a reservoir's pressure");
    }

    #[test]
    fn a_missing_pressure_is_bridged_for_a_flow() {
        let (now, flow) = (Tick::at(0), step(Target::FlowMlS(3.0)));
        let mut controller = PumpController::with_pump(Parameters::example().pump);
        assert_eq!(controller.control(now, &Measurement::NONE, &flow), 0.0, "nothing was measured yet");
        let at_2_bar = controller.control(now, &measured(f64::NAN, 4.0, 2.0), &flow);
        assert_eq!(controller.control(now, &measured(f64::NAN, 4.0, f64::NAN), &flow), at_2_bar);
        let wrong = Measurement { faulty: Input::Pressure1.bit(), ..measured(f64::NAN, 9.0, 2.0) };
        assert_eq!(controller.control(now, &wrong, &flow), at_2_bar, "the device itself calls it wrong");
        assert_ne!(controller.control(now, &measured(f64::NAN, 3.0, 2.0), &flow), at_2_bar);
    }

    #[test]
    fn a_missing_angle_holds_the_voltage_and_a_pump_that_is_cut_off_rests() {
        let mut controller = with_model();
        let angle = step(ANGLE);
        assert_eq!(controller.control(Tick::at(0), &Measurement::NONE, &angle), 0.0, "nothing was measured yet");
        let near = measured(9.0, 2.0, 2.0);
        let mut held = 0.0;
        for index in 1..50 {
            held = controller.control(Tick::at(index), &near, &angle);
        }
        assert!(held > 2.0 && held < 20.0, "it is on its way: {held} V");
        assert_eq!(controller.control(Tick::at(50), &measured(f64::NAN, 2.0, 2.0), &angle), held);
        assert_ne!(controller.control(Tick::at(51), &near, &angle), held);
        for cut_off in [Step { brake_open: false, ..angle }, Step { bypass_open: true, ..angle }] {
            assert_eq!(controller.control(Tick::at(52), &near, &cut_off), 0.0);
        }
        let again = controller.control(Tick::at(53), &near, &angle);
        assert_eq!(again, 0.0, "the loop is closed anew, at the flow that acts");
    }

    fn any_target() -> impl Strategy<Value = Target> {
        use ControlledPressure::{Chamber1, Chamber2, Difference};
        let of = prop_oneof![Just(Chamber1), Just(Chamber2), Just(Difference)];
        prop_oneof![
            (-24.0..24.0_f64).prop_map(Target::VoltageV),
            (-30.0..30.0_f64).prop_map(Target::FlowMlS),
            (of, -8.0..8.0_f64).prop_map(|(of, bar)| Target::PressureBar { of, bar }),
            (-60.0..60.0_f64, -1e3..1e3_f64)
                .prop_map(|(angle_deg, velocity_deg_s)| Target::AngleDeg { angle_deg, velocity_deg_s }),
        ]
    }

    fn mostly(range: std::ops::Range<f64>) -> impl Strategy<Value = f64> {
        prop_oneof![4 => range, 1 => Just(f64::NAN)]
    }

    proptest! {
        /// Whatever the sensors say and the profile asks for, in whatever order, and however many ticks are skipped.
        #[test]
        fn every_answer_is_a_voltage_that_the_pump_takes(
            ticks in prop::collection::vec(
                (any_target(), mostly(-70.0..70.0), mostly(-1.0..20.0), mostly(-1.0..20.0), 0..32_u32, 0..300_u64),
                1..60,
            ),
        ) {
            let mut controller = with_model();
            controller.begin_run();
            let mut index = 0;
            for (target, angle_deg, pressure1_bar, pressure2_bar, faulty, further) in ticks {
                index += further;
                let measured = Measurement { faulty, ..measured(angle_deg, pressure1_bar, pressure2_bar) };
                let voltage_v = controller.control(Tick::at(index), &measured, &step(target));
                prop_assert!(voltage_v.abs() <= 24.0, "{voltage_v} V for {target:?}");
            }
        }
    }
}
