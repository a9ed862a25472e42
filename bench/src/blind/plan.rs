//! Which case is what: shares of the kinds, and effects in turn, so that any number of cases has nearly the same mixture and
//! each can be repeated alone.

use super::foreign::FOREIGN;
use super::forms::{FORMS, name_of};
use model::effects::{Effect, LIBRARY};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// What a case carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// No effect.
    None,
    /// One effect of 2 to 3 noise floors.
    Weak,
    /// One effect of 4 to 8 noise floors.
    Clear,
    /// One effect of 8 to 40 noise floors.
    Gross,
    /// Two effects, both clear.
    Pair,
    /// One effect of 4 to 40 noise floors that is not in the library: left out for this case, or never in it.
    Outside,
}

impl Kind {
    /// All, in the order of the table.
    pub const ALL: [Kind; 6] = [Kind::None, Kind::Weak, Kind::Clear, Kind::Gross, Kind::Pair, Kind::Outside];

    /// As on the command line.
    pub fn as_str(self) -> &'static str {
        ["none", "weak", "clear", "gross", "pair", "outside"][self as usize]
    }

    /// How many effects it carries.
    pub fn effects(self) -> usize {
        match self {
            Kind::None => 0,
            Kind::Pair => 2,
            Kind::Weak | Kind::Clear | Kind::Gross | Kind::Outside => 1,
        }
    }

    /// Strength of each of its effects, noise floors.
    pub fn strength(self) -> std::ops::RangeInclusive<f64> {
        match self {
            Kind::None => 0.0..=0.0,
            Kind::Weak => 2.0..=3.0,
            Kind::Clear | Kind::Pair => 4.0..=8.0,
            Kind::Gross => 8.0..=40.0,
            Kind::Outside => 4.0..=40.0,
        }
    }

    /// Cases of this kind in [`BLOCK`].
    fn share(self) -> usize {
        match self {
            Kind::None => 6,
            Kind::Clear => 4,
            Kind::Weak | Kind::Outside => 3,
            Kind::Gross | Kind::Pair => 2,
        }
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, String> {
        Kind::ALL.into_iter().find(|k| k.as_str() == word).ok_or_else(|| {
            let known: Vec<&str> = Kind::ALL.iter().map(|k| k.as_str()).collect();
            format!("expected one of {}, got {word:?}", known.join(", "))
        })
    }
}

/// So many cases in a row hold each kind by its share.
pub const BLOCK: usize = 20;

/// Streams of a blind run's seed: one a choice, so that none shifts another.
#[derive(Clone, Copy)]
#[repr(u64)]
pub(super) enum Stream {
    Kinds = 1,
    Singles = 2,
    Outside = 3,
    Pairs = 4,
    Rig = 5,
    Sizes = 6,
    Sensors = 7,
    Scripts = 8,
    Forms = 9,
}

/// Chance for one choice of one case (or block, or turn).
pub(super) fn chance(seed: u64, stream: Stream, number: u64) -> ChaCha8Rng {
    // The golden ratio's multiples keep neighbouring numbers apart.
    let mixed = seed ^ number.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut rng = ChaCha8Rng::seed_from_u64(mixed);
    rng.set_stream(stream as u64);
    rng
}

/// What a case is to carry, before sizes are chosen.
#[derive(Clone, Debug)]
pub struct Planned {
    /// Number of the case, from 0.
    pub case: usize,
    /// Its kind.
    pub kind: Kind,
    /// As many as the kind says.
    pub effects: Vec<&'static dyn Effect>,
}

/// Plans the case of this number.
pub fn plan(seed: u64, case: usize) -> Planned {
    let kind = kind_of(seed, case);
    let before = (0..case).filter(|&c| turn_of(kind_of(seed, c)) == turn_of(kind)).count();
    let effects = match kind {
        Kind::None => Vec::new(),
        Kind::Weak | Kind::Clear | Kind::Gross => {
            let effect = in_turn(LIBRARY, seed, Stream::Singles, before);
            vec![in_some_form(effect, &mut chance(seed, Stream::Forms, case as u64))]
        }
        // one that is left out of the library and one that never was in it, by turns
        Kind::Outside if before % 2 == 0 => vec![in_turn(FOREIGN, seed, Stream::Outside, before / 2)],
        Kind::Outside => vec![in_turn(LIBRARY, seed, Stream::Outside, before / 2)],
        Kind::Pair => {
            let mut rng = chance(seed, Stream::Pairs, before as u64);
            let first = rng.random_range(0..LIBRARY.len());
            let second = (first + rng.random_range(1..LIBRARY.len())) % LIBRARY.len();
            vec![LIBRARY[first], LIBRARY[second]]
        }
    };
    Planned { case, kind, effects }
}

/// Kinds that take their effects from one sequence.
fn turn_of(kind: Kind) -> u8 {
    match kind {
        Kind::None => 0,
        Kind::Weak | Kind::Clear | Kind::Gross => 1,
        Kind::Outside => 2,
        Kind::Pair => 3,
    }
}

fn kind_of(seed: u64, case: usize) -> Kind {
    let mut block: Vec<Kind> = Kind::ALL.into_iter().flat_map(|k| std::iter::repeat_n(k, k.share())).collect();
    block.shuffle(&mut chance(seed, Stream::Kinds, (case / BLOCK) as u64));
    block[case % BLOCK]
}

/// The list over and over, in another order each time.
fn in_turn(list: &[&'static dyn Effect], seed: u64, stream: Stream, number: usize) -> &'static dyn Effect {
    let mut order: Vec<&'static dyn Effect> = list.to_vec();
    order.shuffle(&mut chance(seed, stream, (number / list.len()) as u64));
    order[number % list.len()]
}

/// The effect as another simulator would write it, where such a form is known: every other time, by any of those known.
fn in_some_form(effect: &'static dyn Effect, rng: &mut impl Rng) -> &'static dyn Effect {
    let forms = FORMS.iter().map(|(_, form)| *form).filter(|form| name_of(*form) == effect.header().id);
    let others: Vec<&'static dyn Effect> = forms.collect();
    match others[..] {
        [] => effect,
        _ if !rng.random_bool(0.5) => effect,
        [other] => other,
        _ => others[rng.random_range(0..others.len())],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn every_block_holds_each_kind_by_its_share() {
        assert_eq!(Kind::ALL.iter().map(|k| k.share()).sum::<usize>(), BLOCK);
        for block in 0..5 {
            let mut counts: BTreeMap<Kind, usize> = BTreeMap::new();
            for case in block * BLOCK..(block + 1) * BLOCK {
                *counts.entry(kind_of(9, case)).or_default() += 1;
            }
            assert!(Kind::ALL.iter().all(|k| counts[k] == k.share()), "{counts:?}");
        }
        let first: Vec<Kind> = (0..BLOCK).map(|c| kind_of(9, c)).collect();
        assert!(first != (BLOCK..2 * BLOCK).map(|c| kind_of(9, c)).collect::<Vec<_>>(), "another order each time");
    }

    #[test]
    fn singles_go_through_the_whole_library() {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for case in 0..200 {
            let planned = plan(4, case);
            assert_eq!(planned.effects.len(), planned.kind.effects());
            match planned.kind {
                Kind::Weak | Kind::Clear | Kind::Gross => *counts.entry(name_of(planned.effects[0])).or_default() += 1,
                Kind::Pair => assert_ne!(planned.effects[0].header().id, planned.effects[1].header().id),
                Kind::None | Kind::Outside => {}
            }
        }
        assert_eq!(counts.len(), LIBRARY.len());
        assert!(counts.values().max().unwrap_or(&9) - counts.values().min().unwrap_or(&0) <= 1, "{counts:?}");
    }

    #[test]
    fn words_and_kinds_agree() {
        for kind in Kind::ALL {
            assert_eq!(kind.as_str().parse(), Ok(kind));
        }
        assert!("several".parse::<Kind>().unwrap_err().contains("gross"));
    }
}
