//! Which run would tell rival explanations apart.
//!
//! Two rivals that explain a campaign equally well differ in what they predict of a run that was not made. Only that part of the
//! difference counts which no refit could take up: a rival's parameters are known as well as the campaign and the new run determine
//! them, and within that they may move. So, with `r` the difference of the predictions in noise floors, `J` the sensitivities of the
//! rival that is wrong, `H` its information from the campaign:
//!
//! ```text
//! D^2 = min over d of |r - J d|^2 + d' H d = |r|^2 - r' J (H + J' J)^-1 J' r
//! ```
//!
//! is by how much its cost will exceed that of the true one (Atkinson and Fedorov, Biometrika 62, 1975: T-optimal designs; the term
//! with `H` makes the campaign part of the design). The expectation is judged as the diagnosis judges: by sums over clusters, of which
//! one alone convinces nobody.
//!
//! Nothing here knows of profiles: it takes the inputs of a run as a recording would hold them.

mod choice;
mod rivals;
mod separation;

pub use choice::{ENOUGH, Offer, choose};
pub use rivals::{Question, Rival, question, rivals};
pub use separation::{Prior, Separation, separation, would_give};
