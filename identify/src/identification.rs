//! Identification of the reference model from a campaign's runs with role identify.

use std::collections::BTreeMap;
use std::sync::Arc;

use model::Parameters;
use model::integrate::SimulationError;
use model::parameters::NAMES;
use recordings::{CampaignError, Protocol, Role};

use crate::component::{self, CapacityPoint, LossPoint, PumpPoint, TorquePoint};
use crate::determined::{Determined, determined};
use crate::false_minimum::{CREEP, led_out, left_behind, with_plain_losses};
use crate::fit::{Effort, FAR, Fit, fit, fit_from};
use crate::layout::Layout;
pub use crate::loaded::{Loaded, LoadedRun};
use crate::misfit::{self, MATERIAL};
use crate::normal::covariance;
use crate::prepare::{Stand, Stretch, Unusable};
use crate::problem::{Piece, Problem};
use crate::torque_form::{TorqueForm, refit_third_order};

/// What can go wrong from a folder to a model.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// The campaign can't be read.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A run can't be used.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// A recording can't be what its columns say.
    #[error(transparent)]
    Implausible(#[from] crate::plausible::Implausible),
    /// The campaign lacks runs.
    #[error("{campaign}: {why}")]
    Missing {
        /// The campaign's folder.
        campaign: String,
        /// Expected, got, remedy.
        why: String,
    },
    /// A model could not be simulated.
    #[error("simulation of {what}: {source}")]
    Simulation {
        /// Which runs.
        what: String,
        /// Why.
        source: SimulationError,
    },
}

/// Data points of the component experiments.
#[derive(Default)]
pub struct Characteristics {
    /// Fig. 2.
    pub torque: Vec<TorquePoint>,
    /// Fig. 5.
    pub pump: Vec<PumpPoint>,
    /// Fig. 6.
    pub capacity: Vec<CapacityPoint>,
    /// Fig. 7.
    pub loss: Vec<LossPoint>,
}

/// The reference model as identified.
pub struct Identified {
    /// The stretches of the identify runs with their weights.
    pub problem: Problem,
    /// The joint fit in free run.
    pub fit: Fit,
    /// Residuals and derivatives at the end of `fit`, where it left them.
    pub linear: Option<Arc<Vec<Piece>>>,
    /// The fit with the torque as eq. (2) alone, where `fit` has more.
    pub by_eq2: Option<Fit>,
    /// Base parameters that the data do not determine, with the reason.
    pub undetermined: BTreeMap<String, String>,
    /// Values of the paper's separate fits.
    pub component: Parameters,
    /// Data points.
    pub points: Characteristics,
}

/// The paper's separate evaluations, as far as the runs are there.
fn components(loaded: &Loaded, problem: &Problem, start: &mut Parameters) -> Characteristics {
    let mut points = Characteristics::default();
    let runs = |p: Protocol| {
        loaded
            .runs
            .iter()
            .filter(move |r| r.entry.role == Role::Identify && r.entry.protocol == p)
            .map(|r| &r.recording)
    };
    points.torque = runs(Protocol::TorqueMap).flat_map(component::torque_points).collect();
    points.pump = runs(Protocol::PumpMap).flat_map(component::pump_points).collect();
    let pieces: Vec<&Stretch> = problem.stretches.iter().collect();
    points.capacity = component::capacity_points(&pieces);
    points.loss = runs(Protocol::ConstantFlow).flat_map(component::loss_points).collect();
    component::fit_torque(&points.torque, start);
    component::fit_pump(&points.pump, start);
    component::fit_capacity(&pieces, start);
    component::fit_displacement(&pieces, start);
    component::fit_losses(&points.loss, start);
    points
}

/// [`identify_as`] with the torque as eq. (2).
///
/// # Errors
/// As there.
pub fn identify(loaded: &Loaded, progress: &dyn Fn(&str)) -> Result<Identified, IdentifyError> {
    identify_as(loaded, TorqueForm::SecondEquation, progress)
}

/// Identifies the reference model: the paper's separate fits, then all parameters together in free run.
///
/// # Errors
/// No run may be fitted, a run can't be used, or the model can't be simulated on the runs.
pub fn identify_as(loaded: &Loaded, form: TorqueForm, progress: &dyn Fn(&str)) -> Result<Identified, IdentifyError> {
    let mut problem = loaded.problem(Role::Identify)?;
    if problem.stretches.is_empty() {
        return Err(IdentifyError::Missing {
            campaign: loaded.campaign.dir.display().to_string(),
            why: "no run has role \"identify\": nothing may be fitted".into(),
        });
    }
    let mut component = Parameters::example();
    component.load.J = loaded.campaign.rig.inertia_kg_m2;
    component.load.G = loaded.campaign.rig.gravity_nm;
    component.pump.u_max = loaded.campaign.rig.u_max_v;
    let points = components(loaded, &problem, &mut component);
    progress("component experiments evaluated");

    let mut layout = Layout::base(&component);
    bypass_by_scan(&problem, &layout, &mut component);
    let simulation = |what: &str| {
        let what = what.to_string();
        move |source| IdentifyError::Simulation { what, source }
    };

    tracing::debug!(?component, loss = ?points.loss, "component");
    // where a separate fit leads nowhere, usual values do better
    let cost = |p: &Parameters| problem.cost(&layout, &problem.point(layout.vector_of(p)));
    let example = Parameters::example();
    let usual: [fn(&mut Parameters, &Parameters); 4] = [
        |p, usual| p.losses = usual.losses,
        |p, usual| p.capacity = usual.capacity,
        |p, usual| p.displacement = usual.displacement,
        |p, usual| (p.capacity, p.displacement) = (usual.capacity, usual.displacement),
    ];
    let mut least = cost(&component);
    for put in usual {
        let mut other = component;
        put(&mut other, &example);
        let own = cost(&other);
        if own < least {
            (least, component) = (own, other);
        }
    }
    layout.fixed = component.to_vector().to_vec();

    let theta = layout.vector_of(&component);
    let (first, pieces) = rough_fit(&problem, &layout, theta).map_err(simulation("the identify runs"))?;
    let (first, pieces) = out_of_false_minimum(&problem, &component, first, pieces);
    progress("joint fit in free run, first pass");
    let mut pieces = match pieces {
        Some(pieces) => pieces,
        None => problem.linearise(&layout, &first.point).map_err(simulation("the identify runs"))?,
    };
    problem.reweigh(&mut pieces);
    let Determined { undetermined, lost } = determined(&problem, &component, &first, &pieces);
    let all = Layout::base(&component);
    let mut start = first.point.clone();
    for (own, (i, v)) in start.theta.iter_mut().zip(all.base.iter().zip(all.vector_of(&component))) {
        if lost.contains(i) {
            *own = v;
        }
    }
    let of_first = start.theta.clone();
    let of_first = all.base.iter().zip(&of_first);
    layout.base.retain(|i| !undetermined.contains_key(i));
    of_first.clone().filter(|(i, _)| layout.base.contains(i)).for_each(|(i, v)| layout.fixed[*i] = *v);
    start.theta = of_first.clone().filter(|(i, _)| layout.base.contains(i)).map(|(_, v)| *v).collect();
    let undetermined: BTreeMap<String, String> =
        undetermined.into_iter().map(|(i, why)| (NAMES[i].to_owned(), why)).collect();
    let mut known = Some(pieces).filter(|_| undetermined.is_empty() && lost.is_empty());
    if known.is_none() {
        known = problem.linearise(&layout, &start).ok();
        if known.is_none() {
            // what was kept can be simulated with the values that were found beside it alone
            of_first.for_each(|(i, v)| layout.fixed[*i] = *v);
        }
    }
    // a gross misfit bends the parameters whatever is done: no use in polishing them
    let gross = first.cost > FAR * problem.targets() as f64;
    let polish = if gross {
        Effort { iterations: 12, tolerance: 1e-3, promise: f64::INFINITY, creep: CREEP, ..polish() }
    } else {
        polish()
    };
    let (last, at_end) = fit_from(&problem, &layout, start, polish, known).map_err(simulation("the identify runs"))?;
    progress("joint fit in free run, final pass");
    let (fit, by_eq2) = match form {
        TorqueForm::SecondEquation => (last, None),
        TorqueForm::ThirdOrder => {
            let third = refit_third_order(&problem, &last, polish).map_err(simulation("the identify runs"))?;
            progress("joint fit with the torque's terms of third order");
            (third, Some(last))
        }
    };
    let at_end = at_end.filter(|_| by_eq2.is_none());
    let linear = at_end.map(|pieces| problem.keep(&fit.layout, &fit.point, pieces));
    Ok(Identified { problem, fit, linear, by_eq2, undetermined, component, points })
}

/// A first fit that leaves more than noise, or a better one from afar: see [`crate::false_minimum`].
fn out_of_false_minimum(
    problem: &Problem,
    component: &Parameters,
    first: Fit,
    pieces: Option<Vec<Piece>>,
) -> (Fit, Option<Vec<Piece>>) {
    let is_noise = |fit: &Fit| misfit::left_by(problem, fit).is_ok_and(|left| left < MATERIAL);
    if is_noise(&first) {
        return (first, pieces);
    }
    let reached = first.cost;
    let [plain, separate] = [with_plain_losses(*component), *component].map(|values| first.layout.vector_of(&values));
    let mut lowest = left_behind(problem, first, &plain);
    if !is_noise(&lowest) {
        lowest = led_out(problem, lowest, &separate);
    }
    let same = lowest.cost == reached;
    (lowest, pieces.filter(|_| same))
}

/// Standard errors of a fit's entries: see [`covariance_of`].
pub fn standard_errors(problem: &Problem, fit: &Fit) -> Result<Vec<f64>, SimulationError> {
    let c = covariance_of(problem, fit)?;
    Ok((0..fit.layout.len()).map(|i| c[(i, i)].sqrt()).collect())
}

/// Covariance of a fit's entries: from the normal matrix, widened where the residuals are larger than the noise. Entries
/// that are held or without influence have an infinite variance.
pub fn covariance_of(problem: &Problem, fit: &Fit) -> Result<nalgebra::DMatrix<f64>, SimulationError> {
    let pieces = problem.linearised(&fit.layout, &fit.point)?;
    let normal = problem.normal(&pieces, fit.layout.len(), &fit.point);
    let misfit = (fit.cost / problem.targets() as f64).max(1.0);
    Ok(covariance(&normal.matrix) * misfit)
}

/// A first value for k_b: what fits the runs with the lever free best, of a coarse scan.
fn bypass_by_scan(problem: &Problem, layout: &Layout, p: &mut Parameters) {
    let (part, _) = problem.part(|_, s| s.bypass_open.iter().any(|b| *b));
    if part.stretches.is_empty() {
        return;
    }
    let mut best = f64::INFINITY;
    for k_b in [5.0, 15.0, 40.0, 100.0] {
        let mut q = *p;
        q.valves.k_b = k_b;
        let cost = part.cost(layout, &part.point(layout.vector_of(&q)));
        if cost < best {
            best = cost;
            p.valves.k_b = k_b;
        }
    }
}

/// What a next step may still promise at the end of the joint fit, noise variances: see [`Effort::promise`].
pub(crate) const PROMISE: f64 = 0.01;

/// From the component experiments to near the joint minimum: first what stands still, which costs little, then everything. The second
/// part is the linearisation of the end, where it is known.
///
/// # Errors
/// The model can't be simulated from there.
pub fn rough_fit(
    problem: &Problem,
    layout: &Layout,
    start: Vec<f64>,
) -> Result<(Fit, Option<Vec<Piece>>), SimulationError> {
    let mut theta = start;
    let mut known = None;
    let (still, _) = problem.part(|_, s| s.stand != Stand::Free);
    let effort = Effort { iterations: 6, tolerance: 1e-3, ahead: true, ..Effort::default() };
    if !still.stretches.is_empty()
        && let Ok(f) = fit(&still, layout, still.point(theta.clone()), effort)
        && f.point.theta.iter().all(|v| v.is_finite())
    {
        let point = problem.point(f.point.theta);
        if let Ok(pieces) = problem.linearise(layout, &point)
            && problem.cost_of_pieces(&pieces, &point) < problem.cost(layout, &problem.point(theta.clone()))
        {
            (theta, known) = (point.theta, Some(pieces));
        }
    }
    // what a further step gains is left to the polish, which has to take one anyway
    let effort = Effort { iterations: 12, tolerance: 1e-2, ahead: true, ..Effort::default() };
    fit_from(problem, layout, problem.point(theta), effort, known)
}

/// From near the joint minimum to it.
pub fn polish() -> Effort {
    Effort { iterations: 20, tolerance: 1e-6, promise: PROMISE, creep: 0.0, ahead: true }
}
