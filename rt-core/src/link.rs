//! The shared-memory services between the loop and its subscribers: names, sizes, and what can go wrong.
//!
//! | service | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/sample` | publish-subscribe | one [`Sample`] a tick |
//! | `rec-bench/<instance>/progress` | publish-subscribe | how far each lossless logger is |
//! | `rec-bench/<instance>/wake` | event | there are new samples |
//! | `rec-bench/<instance>/command`, `.../command-wake` | request-response, event | commands to the run: [`crate::command_channel`] |
//! | `rec-bench/<instance>/service`, `.../service-wake` | request-response, event | commands to the service: [`crate::service_channel`] |
//!
//! Whoever comes first creates a service and fixes its sizes.

use std::path::PathBuf;
use std::sync::Once;
use std::time::Duration;

use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{event, publish_subscribe};

use crate::leftovers::{self, watched};
use crate::loss::OutOfOrder;
use crate::transport::{self, Foreign};
use crate::types::{BeyondRange, SAMPLE_VERSION, Sample};

/// Samples that a subscriber may lag behind before its oldest are overwritten: 8 s in real time.
pub const BUFFER_SAMPLES: usize = 8192;
/// Subscribers at one time. Together with the buffer this fixes the shared memory, some 25 MB.
pub const MAX_SUBSCRIBERS: usize = 12;
/// The loop, or the bridge that brings its samples from another host. The transport counts them in one step: of two that start at the same moment one
/// is refused.
const MAX_PUBLISHERS: usize = 1;
/// Its other ports: of a publication that ends they may still be there when the next one begins.
const MAX_PUBLISHING: usize = 2;
const MAX_NODES: usize = 16;
/// Progress messages are tiny and the newest says all: old ones may be overwritten.
const PROGRESS_BUFFER: usize = 64;
/// Tries to open a service, and the time between two.
const ATTEMPTS: u32 = 20;
const BETWEEN_ATTEMPTS: Duration = Duration::from_millis(20);
/// Longest instance name; a service name holds 255 bytes.
const INSTANCE_MAX_LEN: usize = 64;

pub(crate) type Ipc = ipc::Service;
pub(crate) type SampleService = publish_subscribe::PortFactory<Ipc, Sample, ()>;
pub(crate) type ProgressService = publish_subscribe::PortFactory<Ipc, Progress, ()>;
pub(crate) type WakeService = event::PortFactory<Ipc>;

/// What a lossless logger reports: it has taken everything of `run` up to, but without, sample number `next_sequence`.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchProgress2")]
pub(crate) struct Progress {
    pub version: u32,
    pub run: u32,
    pub next_sequence: u64,
}

/// What went wrong between the loop and its subscribers.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// The name can't be part of a service name.
    #[error(
        "instance name {0:?}: expected 1..={INSTANCE_MAX_LEN} of a-z, A-Z, 0-9, '-', '_' and '.'; choose another --instance"
    )]
    InstanceName(String),
    /// Another service publishes under this name.
    #[error("instance {instance:?} is in use by another running service; end that one or choose another instance")]
    InUse {
        /// Name of the instance.
        instance: String,
    },
    /// Nobody publishes under this name.
    #[error(
        "instance {instance:?}: no running service of this name listens; check the name, `bench run --instance NAME` sets it"
    )]
    Nobody {
        /// Name of the instance.
        instance: String,
    },
    /// No service that starts runs serves this instance.
    #[error("instance {instance:?}: no service answers; start one with `bench serve --control`, or check --instance")]
    NoService {
        /// Name of the instance.
        instance: String,
    },
    /// The transport's folder is another user's.
    #[error(
        "instance {instance:?}: expected to use the transport's folder {folder}, got one of {owner}; {}",
        transport::REMEDY
    )]
    Foreign {
        /// Name of the instance.
        instance: String,
        /// The folder.
        folder: PathBuf,
        /// Whose it is.
        owner: String,
    },
    /// A service or port could not be had.
    #[error(
        "instance {instance:?}: can't {what}: {cause}; processes of one instance must be of the same build, may be \
         {MAX_SUBSCRIBERS} subscribers at most, and need room in /dev/shm"
    )]
    Open {
        /// Name of the instance.
        instance: String,
        /// What was tried.
        what: &'static str,
        /// The transport's own words.
        cause: String,
    },
    /// The transport failed while it was used.
    #[error(
        "instance {instance:?}: {what} failed: {cause}; end the programs that use this instance and start them again"
    )]
    Transport {
        /// Name of the instance.
        instance: String,
        /// What was tried.
        what: &'static str,
        /// The transport's own words.
        cause: String,
    },
    /// A sample of another version.
    #[error("sample version: expected {SAMPLE_VERSION}, got {got}; service and subscriber must be of the same build")]
    Version {
        /// The version that came.
        got: u32,
    },
    /// A sample of which nothing can be reckoned.
    #[error("sample of run {run}: {beyond}; does a program publish on this instance that is none of this project's?")]
    BeyondRange {
        /// Number of the run.
        run: u32,
        /// What is wrong with it.
        beyond: BeyondRange,
    },
    /// A tick that can't follow those before it.
    #[error(transparent)]
    OutOfOrder(#[from] OutOfOrder),
    /// Something was waited for in vain.
    #[error("waited {waited_s:.1} s for {what}; is the other program stopped, or the machine overloaded?")]
    Timeout {
        /// What did not come.
        what: String,
        /// For how long, seconds.
        waited_s: f64,
    },
    /// The publication thread has ended, by an error that was already reported, or by a panic.
    #[error("the publication thread has ended, for the reason that was said above; start the run again")]
    Ended,
}

impl LinkError {
    /// No node could be had, which is where the transport's folder comes in first.
    pub(crate) fn no_node(instance: &str, cause: &dyn std::fmt::Display) -> LinkError {
        let instance = instance.to_owned();
        match transport::foreign() {
            Some(Foreign { folder, owner }) => LinkError::Foreign { instance, folder, owner },
            None => LinkError::Open { instance, what: "create a node", cause: cause.to_string() },
        }
    }
}

/// One participant's access to the services of an instance. Not to be sent to another thread: ports are made by the
/// thread that uses them.
#[derive(Debug)]
pub(crate) struct Link {
    pub instance: String,
    pub sample: SampleService,
    pub progress: ProgressService,
    pub wake: WakeService,
    pub node: Node<Ipc>,
}

impl Link {
    /// Opens or creates the services. What killed processes left in shared memory is removed on the way.
    pub fn open(instance: &str) -> Result<Link, LinkError> {
        validate_instance(instance)?;
        watched(|| Link::open_watched(instance))
    }

    fn open_watched(instance: &str) -> Result<Link, LinkError> {
        let failed = |what, cause: String| LinkError::Open { instance: instance.to_owned(), what, cause };
        let node = leftovers::node().map_err(|e| LinkError::no_node(instance, &e))?;
        let name = |part: &str| {
            let name = format!("rec-bench/{instance}/{part}");
            ServiceName::new(&name).map_err(|e| failed("name a service", e.to_string()))
        };
        let sample_name = name("sample")?;
        let sample = patiently(|| {
            node.service_builder(&sample_name)
                .publish_subscribe::<Sample>()
                .enable_safe_overflow(true)
                .subscriber_max_buffer_size(BUFFER_SAMPLES)
                .subscriber_max_borrowed_samples(4)
                .history_size(0)
                .max_subscribers(MAX_SUBSCRIBERS)
                .max_publishers(MAX_PUBLISHERS)
                .max_nodes(MAX_NODES)
                .open_or_create()
        })
        .map_err(|e| failed("open the sample service", e.to_string()))?;
        let progress_name = name("progress")?;
        let progress = patiently(|| {
            node.service_builder(&progress_name)
                .publish_subscribe::<Progress>()
                .enable_safe_overflow(true)
                .subscriber_max_buffer_size(PROGRESS_BUFFER)
                .subscriber_max_borrowed_samples(2)
                .history_size(0)
                .max_subscribers(MAX_PUBLISHING)
                .max_publishers(MAX_SUBSCRIBERS)
                .max_nodes(MAX_NODES)
                .open_or_create()
        })
        .map_err(|e| failed("open the progress service", e.to_string()))?;
        let wake_name = name("wake")?;
        let wake = patiently(|| {
            node.service_builder(&wake_name)
                .event()
                .max_notifiers(MAX_PUBLISHING)
                .max_listeners(MAX_SUBSCRIBERS)
                .max_nodes(MAX_NODES)
                .event_id_max_value(0)
                .open_or_create()
        })
        .map_err(|e| failed("open the wake service", e.to_string()))?;
        Ok(Link { instance: instance.to_owned(), sample, progress, wake, node })
    }

    /// The port on which the loop publishes; refused while another loop does.
    pub fn loop_publisher(&self) -> Result<Publisher<Ipc, Sample, ()>, LinkError> {
        let port = self
            .sample
            .publisher_builder()
            .max_loaned_samples(2)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create();
        port.map_err(|error| match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers => LinkError::InUse { instance: self.instance.clone() },
            other => self.failed("create the sample publisher", other.to_string()),
        })
    }

    /// Ids of the ports on which lossless loggers report; each of them has exactly one.
    pub fn logger_ids(&self, ids: &mut Vec<u128>) {
        ids.clear();
        self.progress.dynamic_config().list_publishers(|details| {
            ids.push(details.publisher_id.value());
            CallbackProgression::Continue
        });
    }

    pub fn failed(&self, what: &'static str, cause: String) -> LinkError {
        LinkError::Open { instance: self.instance.clone(), what, cause }
    }

    pub fn broken(&self, what: &'static str, cause: String) -> LinkError {
        LinkError::Transport { instance: self.instance.clone(), what, cause }
    }
}

/// A service that its last user is leaving at this moment can neither be opened nor created; a moment later it can be
/// created. What fails for another reason fails again.
pub(crate) fn patiently<T, E>(mut attempt: impl FnMut() -> Result<T, E>) -> Result<T, E> {
    for _ in 0..ATTEMPTS {
        if let Ok(service) = attempt() {
            return Ok(service);
        }
        std::thread::sleep(BETWEEN_ATTEMPTS);
    }
    attempt()
}

/// Whether this can be an instance's name, and part of a file's.
///
/// # Errors
/// It can't.
pub fn validate_instance(instance: &str) -> Result<(), LinkError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if (1..=INSTANCE_MAX_LEN).contains(&instance.len()) && instance.chars().all(allowed) {
        Ok(())
    } else {
        Err(LinkError::InstanceName(instance.to_owned()))
    }
}

/// The transport tells on the console what it also returns as an error. `IOX2_LOG_LEVEL` still opens it up.
pub(crate) fn quieten() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| set_log_level_from_env_or(LogLevel::Fatal));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instance_name_that_would_leave_its_place_is_refused() {
        for name in ["", "a/b", "a b", "ä", &"x".repeat(INSTANCE_MAX_LEN + 1)] {
            assert_eq!(validate_instance(name), Err(LinkError::InstanceName(name.to_owned())));
        }
        assert_eq!(validate_instance("demo-1.2_x"), Ok(()));
    }
}
