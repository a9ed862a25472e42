//! Stop and emergency stop from another process: an event service beside those of the samples.
//!
//! | service | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/demand` | event | id 1: stop; id 2: emergency stop |

use std::sync::atomic::Ordering;
use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event::PortFactory;

use crate::link::{Ipc, LinkError, patiently, quieten, validate_instance};
use crate::traits::{Demand, Switches};

const STOP: usize = 1;
const EMERGENCY_STOP: usize = 2;
const MAX_SENDERS: usize = 8;

fn failed(instance: &str, what: &'static str, cause: &dyn std::fmt::Display) -> LinkError {
    LinkError::Open { instance: instance.to_owned(), what, cause: cause.to_string() }
}

fn node(instance: &str) -> Result<(Node<Ipc>, ServiceName), LinkError> {
    validate_instance(instance)?;
    quieten();
    let node = NodeBuilder::new().signal_handling_mode(SignalHandlingMode::Disabled).create::<Ipc>();
    let node = node.map_err(|e| failed(instance, "create a node", &e))?;
    let name = ServiceName::new(&format!("rec-bench/{instance}/demand"));
    Ok((node, name.map_err(|e| failed(instance, "name a service", &e))?))
}

/// The service's end. Belongs to the thread that opened it.
#[derive(Debug)]
pub struct DemandListener {
    listener: Listener<Ipc>,
    _service: PortFactory<Ipc>,
    _node: Node<Ipc>,
    instance: String,
}

impl DemandListener {
    /// Listens for demands to `instance`.
    pub fn open(instance: &str) -> Result<Self, LinkError> {
        let (node, name) = node(instance)?;
        let service = patiently(|| {
            node.service_builder(&name)
                .event()
                .max_notifiers(MAX_SENDERS)
                .max_listeners(2)
                .event_id_max_value(EMERGENCY_STOP)
                .open_or_create()
        })
        .map_err(|e| failed(instance, "open the demand service", &e))?;
        let listener = service.listener_builder().create();
        let listener = listener.map_err(|e| failed(instance, "create the demand listener", &e))?;
        Ok(DemandListener { listener, _service: service, _node: node, instance: instance.to_owned() })
    }

    /// Waits up to `timeout` for a demand and throws the switches that it names.
    pub fn serve(&self, timeout: Duration, switches: &Switches) -> Result<(), LinkError> {
        let thrown = self.listener.timed_wait(
            |activation| match activation.id.as_value() {
                STOP => switches.stop.store(true, Ordering::Relaxed),
                EMERGENCY_STOP => switches.emergency_stop.store(true, Ordering::Relaxed),
                // Nothing else can be sent through this service.
                _ => {}
            },
            timeout,
        );
        match thrown {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(error) => Err(LinkError::Transport {
                instance: self.instance.clone(),
                what: "waiting for a demand",
                cause: error.to_string(),
            }),
        }
    }
}

/// Asks the service of `instance` for a stop or an emergency stop. That it was heard is seen in its samples.
///
/// # Errors
/// No service of this name listens.
pub fn send_demand(instance: &str, demand: Demand) -> Result<(), LinkError> {
    let id = match demand {
        Demand::None => return Ok(()),
        Demand::Stop => STOP,
        Demand::EmergencyStop => EMERGENCY_STOP,
    };
    let (node, name) = node(instance)?;
    // What a killed service left behind would take the demand without anybody hearing it.
    node.try_cleanup_dead_nodes();
    let nobody = || LinkError::Nobody { instance: instance.to_owned() };
    let service = node.service_builder(&name).event().open().map_err(|_| nobody())?;
    let notifier = service.notifier_builder().create().map_err(|e| failed(instance, "create the notifier", &e))?;
    let heard = notifier.notify_with_custom_event_id(EventId::new(id));
    match heard.map_err(|e| failed(instance, "send the demand", &e))? {
        0 => Err(nobody()),
        _ => Ok(()),
    }
}
