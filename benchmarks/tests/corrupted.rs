//! A campaign with 1 % of its samples spoilt gives the parameters of the campaign as it was.

#![allow(clippy::unwrap_used, reason = "a test")]

use benchmarks::campaign::{corrupt, draw, recorded};
use drivers::emulated::Noise;
use identify::identification::{Loaded, identify};
use identify::prepare::Channel;
use identify::uncertainty::Uncertainty;

#[test]
fn spikes_dropouts_and_values_that_stand_still_move_no_parameter_by_a_standard_error() {
    let truth = draw(5);
    let (campaign, clean) = recorded(&truth, Noise::default(), 5).unwrap();
    let mut spoilt = clean.clone();
    for (seed, r) in (100..).zip(&mut spoilt) {
        corrupt(r, 0.01, seed);
    }
    let clean = Loaded::from_recordings(campaign.clone(), clean);
    let spoilt = Loaded::from_recordings(campaign, spoilt);
    for run in &clean.runs {
        // where the lever starts or the operator fills, a sample or two may look like it
        let lost: usize = Channel::ALL.iter().map(|c| run.corruption.of(*c)).sum();
        assert!(lost < 5, "{}: {:?}", run.entry.file, run.corruption);
    }
    let found = |loaded: &Loaded| {
        let identified = identify(loaded, &|_| ()).unwrap();
        let uncertainty = Uncertainty::of(&identified.problem, &identified.fit).unwrap();
        let values = identified.fit.layout.parameters(&identified.fit.point.theta).to_vector();
        (values, uncertainty.determined())
    };
    let (before, known) = found(&clean);
    let (after, still_known) = found(&spoilt);
    assert_eq!(known.len(), still_known.len());
    assert_eq!(known.len(), 19, "a whole campaign determines everything");
    for ((p, name, std), (_, _, std_after)) in known.into_iter().zip(still_known) {
        let moved = (after[p] - before[p]) / std;
        assert!(moved.abs() < 1.0, "{name} moved by {moved:.2} standard errors: {} from {}", after[p], before[p]);
        assert!(std_after < 1.3 * std, "{name} is less certain: {std_after} from {std}");
    }
}
