//! Blind trials: campaigns of emulated rigs whose effects are sealed, diagnosed and then opened.
//!
//! | module | what |
//! |---|---|
//! | [`plan`] | which case is of which kind |
//! | [`rig`] | the drawn rig and the shapes of its effects |
//! | [`forms`] | other forms of the library's effects |
//! | [`foreign`] | effects that the library does not have |
//! | [`sensors`] | its sensors |
//! | [`scripts`] | its experiments |
//! | [`runs`] | the campaign in memory |
//! | `yardstick` | how strong an effect is |
//! | [`trial`] | one case from draw to judgement |
//! | [`case`] | what is known of it then |
//! | [`judge`] | what a verdict is worth |
//! | [`table`] | the confusion table and the targets |
//! | [`times`] | how long a verdict took |
//! | [`store`] | results on disk, for a run that goes on later |

pub mod case;
pub mod foreign;
pub mod forms;
pub mod judge;
pub mod plan;
pub mod rig;
pub mod runs;
pub mod scripts;
pub mod sensors;
pub mod store;
pub mod table;
pub mod times;
pub mod trial;
mod yardstick;
