//! The service whose samples are recorded, seen from outside: is it still there, and can it be asked to stop?

use iceoryx2::prelude::*;
use rt_core::{Demand, LinkError, Sample, send_demand};

/// Whether anybody publishes samples on `instance`. What a killed service left behind is removed first.
///
/// To be asked when samples fail to come: a process that is merely stalled still counts as one that publishes.
///
/// # Errors
/// The instance's services can't be looked at.
pub fn publishes(instance: &str) -> Result<bool, LinkError> {
    let failed = |what, cause: String| LinkError::Open { instance: instance.to_owned(), what, cause };
    let node = NodeBuilder::new().signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>();
    let node = node.map_err(|e| failed("create a node", e.to_string()))?;
    node.try_cleanup_dead_nodes();
    let name = ServiceName::new(&format!("rec-bench/{instance}/sample"));
    let name = name.map_err(|e| failed("name the sample service", e.to_string()))?;
    let service = node.service_builder(&name).publish_subscribe::<Sample>().open();
    let service = service.map_err(|e| failed("open the sample service", e.to_string()))?;
    let mut publishers = 0;
    service.dynamic_config().list_publishers(|_| {
        publishers += 1;
        CallbackProgression::Continue
    });
    Ok(publishers > 0)
}

/// Asks the service of `instance` for an orderly end of its run. That it was heard is seen in the samples.
///
/// # Errors
/// No service of this name listens.
pub fn ask_to_stop(instance: &str) -> Result<(), LinkError> {
    send_demand(instance, Demand::Stop)
}
