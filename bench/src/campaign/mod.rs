//! Runs scripts on a rig and leaves a campaign folder: `plan.toml`, the recordings and `campaign.toml`.
//!
//! The plan is written before anything moves, so that the same command on the same folder goes on where it was interrupted. What a run
//! is given beyond its script (its number, the seed, what was measured before it) follows from the plan and from the recordings of the
//! runs before it alone: a campaign on the emulated rig that was interrupted ends up with the same bytes as one that was not.
//!
//! | module | |
//! |---|---|
//! | [`order`] | which run needs what, and the order that follows |
//! | [`plan`] | `plan.toml`: written, read, compared |
//! | [`folder`] | the folder: claimed by one process, new or resumed |
//! | [`standing`] | whether a run is there as its script wanted it |
//! | [`set_aside`] | what an interrupted, tripped or lossy run left |
//! | [`known`] | pump and model, from the runs recorded so far |
//! | [`session`] | the runs themselves |
//! | [`outlook`] | how much is done and how long the rest takes |

pub mod folder;
pub mod known;
pub mod order;
pub mod outlook;
pub mod plan;
pub mod session;
pub mod set_aside;
pub mod standing;

pub use folder::{Folder, make_folder};
pub use plan::{PLAN_FILE, Plan};
pub use session::{Recorded, Session, Settings};
