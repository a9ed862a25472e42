//! Figs. 2, 5, 6, 7: torque, pump, capacity and losses, points and model.

use crate::figure::{Figure, Mark};
use crate::figures::plant::Plant;
use crate::figures::text::number;
use crate::figures::{Subject, grid, levels, nearest, range, section, series};

/// Points on a model's curve.
const SMOOTH: usize = 61;

pub(super) fn figures(subject: &Subject) -> Vec<Figure> {
    let models = Models {
        before: Plant::of(&subject.identified.fit),
        after: subject.after().map(Plant::of),
        name: subject.last_name(),
    };
    vec![torque(subject, &models), pump(subject, &models), capacity(subject, &models), losses(subject, &models)]
}

/// The model that is drawn full, and the reference model beside it where something was added.
struct Models {
    before: Plant,
    after: Option<Plant>,
    name: String,
}

impl Models {
    fn last(&self) -> &Plant {
        self.after.as_ref().unwrap_or(&self.before)
    }

    /// Full curve of the final model in the colour of its group.
    fn curve(
        &self,
        figure: &mut Figure,
        label: &str,
        group: usize,
        x: impl Iterator<Item = f64>,
        y: impl Fn(&Plant, f64) -> f64,
    ) {
        let last = self.last();
        figure.series.push(series(label, Mark::Line, group, x.map(|x| (x, y(last, x)))));
    }

    /// All curves of the reference model as one dashed series, where another model is drawn full.
    fn reference(&self, figure: &mut Figure, groups: usize, curves: Vec<Vec<(f64, f64)>>) {
        if self.after.is_some() && !curves.is_empty() {
            let gap = |curve: Vec<(f64, f64)>| {
                let end = curve.last().map(|p| (p.0, f64::NAN));
                curve.into_iter().chain(end)
            };
            figure.series.push(series("reference model", Mark::Dashed, groups, curves.into_iter().flat_map(gap)));
        }
        let full = if self.after.is_some() { format!(" Full lines: the model {}.", self.name) } else { String::new() };
        figure.caption.push_str(&full);
    }

    /// Points and curves of each level of the quantity that an experiment holds constant.
    fn family(
        &self,
        figure: &mut Figure,
        levels: &[f64],
        label: impl Fn(f64) -> String,
        points: impl Fn(usize) -> Vec<(f64, f64)>,
        y: impl Fn(&Plant, f64, f64) -> f64,
    ) {
        let mut dashed = Vec::new();
        for (group, level) in levels.iter().enumerate() {
            let own = points(group);
            let Some((low, high)) = range(own.iter().map(|p| p.0)) else { continue };
            let label = label(*level);
            figure.series.push(series(format!("{label} measured"), Mark::Points, group, own));
            let x = grid(low, high, SMOOTH);
            self.curve(figure, &format!("{label} model"), group, x.clone(), |plant, x| y(plant, *level, x));
            dashed.push(x.map(|x| (x, y(&self.before, *level, x))).collect());
        }
        self.reference(figure, levels.len(), dashed);
    }
}

/// `-40°`, never `-0°`.
fn degrees(angle: f64) -> String {
    format!("{}°", angle.round() + 0.0)
}

fn empty(id: &str, title: &str, caption: String, x_label: &str, y_label: &str) -> Figure {
    Figure {
        id: id.into(),
        section: section::IDENTIFICATION.into(),
        title: title.into(),
        caption,
        x_label: x_label.into(),
        y_label: y_label.into(),
        series: Vec::new(),
    }
}

/// Fig. 2: torque that the clamp holds over the pressure difference, one colour an angle.
fn torque(subject: &Subject, models: &Models) -> Figure {
    let caption =
        "Counterpart of fig. 2 (and its mirror image, chamber 2 active): mean of the last third of each clamped \
                   segment, and eq. (2) with what else acts on the clamped lever."
            .to_string();
    let mut figure =
        empty("torque_map", "Torque characteristic", caption, "pressure difference p1 - p2 / bar", "torque / Nm");
    let points = &subject.identified.points.torque;
    let angles = levels(points.iter().map(|p| p.angle_deg), 1.0);
    let middle = mean_pressure(subject);
    let own = |group: usize| {
        let own = points.iter().filter(|p| nearest(&angles, p.angle_deg) == group);
        own.map(|p| (p.dp_bar, p.torque_nm)).collect()
    };
    models.family(&mut figure, &angles, degrees, own, |plant, angle, dp| {
        plant.held_torque_nm(angle, [middle + 0.5 * dp, (middle - 0.5 * dp).max(0.1)], false)
    });
    figure
}

/// Mean of both pressures over the torque map: they move apart about it.
fn mean_pressure(subject: &Subject) -> f64 {
    let runs = subject.loaded.runs.iter().filter(|r| r.entry.protocol == recordings::Protocol::TorqueMap);
    let values = runs.flat_map(|r| r.recording.pressure1_bar.iter().chain(&r.recording.pressure2_bar).copied());
    let (mean, n) = crate::noise::mean(values);
    if n > 0 { mean } else { 2.5 }
}

/// Fig. 5: flow of the pump over the pressure difference, one colour a voltage.
fn pump(subject: &Subject, models: &Models) -> Figure {
    let caption =
        "Counterpart of fig. 5: slope of the measured volume over time at each set point, and eq. (10) with its dead \
                   zone, both directions."
            .to_string();
    let mut figure =
        empty("pump_map", "Pump characteristic", caption, "pressure difference p1 - p2 / bar", "flow / ml/s");
    let points = &subject.identified.points.pump;
    let voltages = levels(points.iter().map(|p| p.voltage_v), 0.2);
    let own = |group: usize| {
        let own = points.iter().filter(|p| nearest(&voltages, p.voltage_v) == group);
        own.map(|p| (p.dp_bar, p.flow_ml_s)).collect()
    };
    let label = |voltage: f64| format!("{} V", (voltage * 100.0).round() / 100.0);
    models.family(&mut figure, &voltages, label, own, Plant::pump_flow_ml_s);
    figure
}

/// Fig. 6: capacity over pressure, one colour an angle.
fn capacity(subject: &Subject, models: &Models) -> Figure {
    let caption =
        "Counterpart of fig. 6: released volume over the fall of the pressure, eq. (12), at the middle of each step, \
                   and eq. (13) with what else takes up oil."
            .to_string();
    let mut figure =
        empty("capacity", "Hydraulic capacity of chamber 1", caption, "pressure / bar", "capacity / ml/bar");
    let points = &subject.identified.points.capacity;
    if let Some(c) = crate::component::capacity_in_two_steps(points) {
        let [h1, h2, h3, a1, a2] = [c.h1, c.h2, c.h3, c.a1, c.a2].map(|v| number(v, 3));
        figure.caption.push_str(&format!(
            " From these points in the paper's two steps: over the pressure at the angle nearest to 0, h1 = {h1}, h2 = {h2}, h3 = {h3}; \
             then over the angle, a1 = {a1} 1/deg, a2 = {a2}. The joint fit takes whole series of releases, with a2 in h1 and h3."
        ));
    }
    let angles = levels(points.iter().map(|p| p.angle_deg), 2.0);
    let own = |group: usize| {
        let own = points.iter().filter(|p| nearest(&angles, p.angle_deg) == group);
        own.map(|p| (p.pressure_bar, p.capacity_ml_bar)).collect()
    };
    models.family(&mut figure, &angles, degrees, own, Plant::capacity_ml_bar);
    figure
}

/// Fig. 7: losses over velocity.
fn losses(subject: &Subject, models: &Models) -> Figure {
    let points = &subject.identified.points.loss;
    let (load, n) = crate::noise::mean(points.iter().map(|p| p.load_bar));
    let load = if n > 0 { load } else { 5.0 };
    let caption = format!(
        "Counterpart of fig. 7: torque by eq. (2) from the measured pressures and angles while the velocity is steady, and eq. (16) \
         with what else brakes, at p1 + p2 = {} bar.",
        number(load, 3)
    );
    let mut figure = empty("losses", "Torque losses", caption, "velocity / rad/s", "torque / Nm");
    let last = models.last();
    let measured = points.iter().map(|p| (p.velocity_rad_s, last.torque_nm(p.angle_deg, p.dp_bar)));
    figure.series.push(series("measured", Mark::Points, 0, measured));
    let Some((low, high)) = range(points.iter().map(|p| p.velocity_rad_s)) else { return figure };
    let reach = low.abs().max(high.abs());
    let least = if low < 0.0 { -reach } else { 0.0 };
    let x = grid(least, reach, 4 * SMOOTH);
    models.curve(&mut figure, "model", 0, x.clone(), |plant, w| plant.loss_nm(w, load));
    models.reference(&mut figure, 1, vec![x.map(|w| (w, models.before.loss_nm(w, load))).collect()]);
    figure
}
