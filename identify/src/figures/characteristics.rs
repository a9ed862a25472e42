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

    /// Curves of one group: full for the final model, dashed for the reference model.
    fn curves(
        &self,
        figure: &mut Figure,
        label: &str,
        group: usize,
        x: impl Iterator<Item = f64> + Clone,
        y: impl Fn(&Plant, f64) -> f64,
    ) {
        let last = self.last();
        figure.series.push(series(
            format!("{} {label}", self.name),
            Mark::Line,
            group,
            x.clone().map(|x| (x, y(last, x))),
        ));
        if self.after.is_some() {
            let name = format!("reference model {label}");
            figure.series.push(series(name, Mark::Dashed, group, x.map(|x| (x, y(&self.before, x)))));
        }
    }
}

fn empty(id: &str, title: &str, caption: String, x_label: &str, y_label: &str) -> Figure {
    Figure {
        id: id.into(),
        section: section::CHARACTERISTICS.into(),
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
    for (group, angle) in angles.iter().enumerate() {
        let own: Vec<(f64, f64)> =
            points.iter().filter(|p| nearest(&angles, p.angle_deg) == group).map(|p| (p.dp_bar, p.torque_nm)).collect();
        let label = format!("{angle:.0}°");
        let Some((low, high)) = range(own.iter().map(|p| p.0)) else { continue };
        figure.series.push(series(format!("measured {label}"), Mark::Points, group, own));
        let y = |plant: &Plant, dp: f64| {
            plant.held_torque_nm(*angle, [middle + 0.5 * dp, (middle - 0.5 * dp).max(0.1)], false)
        };
        models.curves(&mut figure, &label, group, grid(low, high, SMOOTH), y);
    }
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
    for (group, voltage) in voltages.iter().enumerate() {
        let own: Vec<(f64, f64)> = points
            .iter()
            .filter(|p| nearest(&voltages, p.voltage_v) == group)
            .map(|p| (p.dp_bar, p.flow_ml_s))
            .collect();
        let Some((low, high)) = range(own.iter().map(|p| p.0)) else { continue };
        let label = format!("{} V", number(*voltage, 3));
        figure.series.push(series(format!("measured {label}"), Mark::Points, group, own));
        models.curves(&mut figure, &label, group, grid(low, high, SMOOTH), |plant, dp| {
            plant.pump_flow_ml_s(*voltage, dp)
        });
    }
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
    let angles = levels(points.iter().map(|p| p.angle_deg), 2.0);
    for (group, angle) in angles.iter().enumerate() {
        let own: Vec<(f64, f64)> = points
            .iter()
            .filter(|p| nearest(&angles, p.angle_deg) == group)
            .map(|p| (p.pressure_bar, p.capacity_ml_bar))
            .collect();
        let Some((low, high)) = range(own.iter().map(|p| p.0)) else { continue };
        let label = format!("{angle:.0}°");
        figure.series.push(series(format!("measured {label}"), Mark::Points, group, own));
        models.curves(&mut figure, &label, group, grid(low, high, SMOOTH), |plant, p| plant.capacity_ml_bar(*angle, p));
    }
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
    models.curves(&mut figure, "", 0, grid(least, reach, 4 * SMOOTH), |plant, w| plant.loss_nm(w, load));
    for s in &mut figure.series {
        s.name = s.name.trim().to_string();
    }
    figure
}
