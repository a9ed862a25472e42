//! What follows when the system refuses to write a run's recording on.

use crate::progress::Progress;
use crate::recorder::{OnFull, ask_to_stop};
use recordings::CutShort;
use std::sync::{Arc, Mutex, PoisonError};

/// Why the run under way was stopped, where its recording is the reason; nobody else wanted its end. Shared with the logger's thread.
#[derive(Clone, Debug, Default)]
pub(super) struct StoppedFor(Arc<Mutex<Option<CutShort>>>);

impl StoppedFor {
    /// What the logger does when a recording of `instance` is cut short: it says so, and asks for the end of the run where that is wanted.
    pub fn on_cut(
        &self,
        on_full: OnFull,
        instance: &str,
        progress: &Progress,
    ) -> Box<dyn FnMut(&CutShort) + Send + 'static> {
        let (reason, instance, said) = (self.clone(), instance.to_owned(), progress.clone());
        Box::new(move |cut| {
            let follows = match on_full {
                OnFull::GoOn => "the run goes on unrecorded".to_owned(),
                OnFull::Stop => match ask_to_stop(&instance) {
                    Ok(()) => {
                        reason.keep(Some(cut.clone()));
                        "the run is stopped".to_owned()
                    }
                    Err(error) => format!("the run could not be stopped: {error}"),
                },
            };
            said.say(&format!("{cut}; {follows}"));
        })
    }

    /// Nothing is the reason.
    pub fn forget(&self) {
        self.keep(None);
    }

    /// The reason, where there was one since [`StoppedFor::forget`].
    pub fn reason(&self) -> Option<CutShort> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn keep(&self, reason: Option<CutShort>) {
        // A value that is set whole is whole after a panic, too.
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = reason;
    }
}
