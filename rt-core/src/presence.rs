//! Whether anybody publishes under an instance's name, and what every participant begins with.

use iceoryx2::prelude::*;

use crate::leftovers::{self, watched};
use crate::link::{Ipc, LinkError, validate_instance};
use crate::types::Sample;

/// Whether anybody publishes samples on `instance`. What a killed service left behind is removed first.
///
/// To be asked when samples fail to come: a process that is merely stalled still counts as one that publishes.
///
/// # Errors
/// The instance's services can't be looked at.
pub fn is_published(instance: &str) -> Result<bool, LinkError> {
    watched(|| {
        let (node, name) = participant(instance, "sample")?;
        node.try_cleanup_dead_nodes();
        let service = node.service_builder(&name).publish_subscribe::<Sample>().open();
        let service = service.map_err(|e| failed(instance, "open the sample service", &e))?;
        Ok(service.dynamic_config().number_of_publishers() > 0)
    })
}

/// A node, and the name of one of the instance's services. To be called within [`watched`].
pub(crate) fn participant(instance: &str, service: &str) -> Result<(Node<Ipc>, ServiceName), LinkError> {
    validate_instance(instance)?;
    let node = leftovers::node().map_err(|e| LinkError::no_node(instance, &e))?;
    let name = ServiceName::new(&format!("rec-bench/{instance}/{service}"));
    Ok((node, name.map_err(|e| failed(instance, "name a service", &e))?))
}

pub(crate) fn failed(instance: &str, what: &'static str, cause: &dyn std::fmt::Display) -> LinkError {
    LinkError::Open { instance: instance.to_owned(), what, cause: cause.to_string() }
}
