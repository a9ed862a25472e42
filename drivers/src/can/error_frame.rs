//! What the controller tells in error frames (linux/can/error.h).

use super::Condition;
use socketcan::CanErrorFrame;
use socketcan::errors::{
    CAN_ERROR_PASSIVE_THRESHOLD, CAN_ERROR_WARNING_THRESHOLD, CanError as Cause, ControllerProblems, ErrorCause,
};
use std::fmt;

/// A decoded error frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorFrame {
    /// All that it says: lost arbitration, controller, protocol, transceiver, no acknowledgement, bus-off, restart, counters.
    pub cause: Cause,
}

impl ErrorFrame {
    pub(super) fn new(frame: CanErrorFrame) -> ErrorFrame {
        ErrorFrame { cause: frame.into_error() }
    }

    /// The condition of the controller after it, if it says one.
    pub fn condition(&self) -> Option<Condition> {
        if self.cause.is_bus_off() {
            return Some(Condition::BusOff);
        }
        let told = self.cause.controller().and_then(|problems| {
            let any = |these| problems.intersects(these);
            if any(ControllerProblems::RX_PASSIVE | ControllerProblems::TX_PASSIVE) {
                Some(Condition::Passive)
            } else if any(ControllerProblems::RX_WARNING | ControllerProblems::TX_WARNING) {
                Some(Condition::Warning)
            } else {
                any(ControllerProblems::ACTIVE).then_some(Condition::Active)
            }
        });
        let restarted = || self.cause.is_restarted().then_some(Condition::Active);
        told.or_else(restarted)
    }

    /// The controller's transmit and receive error counters, if it says them.
    pub fn counters(&self) -> Option<(u8, u8)> {
        self.cause.counters()
    }

    /// The condition that goes with the counters (ISO 11898-1), if it says them; bus-off can't be seen in them.
    pub fn condition_of_counters(&self) -> Option<Condition> {
        let (transmit, receive) = self.counters()?;
        let worst = u32::from(transmit.max(receive));
        Some(if worst >= CAN_ERROR_PASSIVE_THRESHOLD as u32 {
            Condition::Passive
        } else if worst >= CAN_ERROR_WARNING_THRESHOLD as u32 {
            Condition::Warning
        } else {
            Condition::Active
        })
    }

    /// Whether it tells of something beyond a change of the condition: a frame that was spoilt, not acknowledged, or lost.
    pub fn is_problem(&self) -> bool {
        self.cause.causes().any(|cause| match cause {
            ErrorCause::Controller(problems) => {
                problems.intersects(ControllerProblems::RX_OVERFLOW | ControllerProblems::TX_OVERFLOW)
            }
            ErrorCause::BusOff | ErrorCause::Restarted | ErrorCause::Counters { .. } => false,
            _ => true,
        })
    }
}

impl fmt::Display for ErrorFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.cause.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use libc::{
        CAN_ERR_ACK, CAN_ERR_BUSERROR, CAN_ERR_BUSOFF, CAN_ERR_CNT, CAN_ERR_CRTL, CAN_ERR_PROT, CAN_ERR_RESTARTED,
    };

    fn error(classes: u32, data: [u8; 8]) -> ErrorFrame {
        ErrorFrame::new(CanErrorFrame::new_error(classes, &data).expect("8 bytes"))
    }

    #[test]
    fn conditions_are_those_of_the_controller() {
        use Condition::{Active, BusOff, Passive, Warning};
        let controller = |bits: i32| error(CAN_ERR_CRTL, [0, bits as u8, 0, 0, 0, 0, 0, 0]).condition();
        assert_eq!(controller(libc::CAN_ERR_CRTL_TX_WARNING), Some(Warning));
        assert_eq!(controller(libc::CAN_ERR_CRTL_RX_WARNING | libc::CAN_ERR_CRTL_TX_WARNING), Some(Warning));
        assert_eq!(controller(libc::CAN_ERR_CRTL_RX_WARNING | libc::CAN_ERR_CRTL_TX_PASSIVE), Some(Passive));
        assert_eq!(controller(libc::CAN_ERR_CRTL_ACTIVE), Some(Active));
        assert_eq!(controller(libc::CAN_ERR_CRTL_RX_OVERFLOW), None);
        assert_eq!(error(CAN_ERR_BUSOFF | CAN_ERR_CRTL, [0, 0x20, 0, 0, 0, 0, 0, 0]).condition(), Some(BusOff));
        assert_eq!(error(CAN_ERR_RESTARTED, [0; 8]).condition(), Some(Active));
        assert_eq!(error(CAN_ERR_PROT | CAN_ERR_BUSERROR, [0; 8]).condition(), None);
    }

    #[test]
    fn counters_count_where_the_frame_says_that_it_has_them() {
        use Condition::{Active, Passive, Warning};
        let counters = |tx, rx| error(CAN_ERR_CNT, [0, 0, 0, 0, 0, 0, tx, rx]);
        assert_eq!(counters(95, 3).counters(), Some((95, 3)));
        let conditions =
            [(95, 0), (96, 0), (0, 127), (0, 128), (255, 0)].map(|(tx, rx)| counters(tx, rx).condition_of_counters());
        assert_eq!(conditions, [Active, Warning, Warning, Passive, Passive].map(Some));
        assert_eq!(error(CAN_ERR_ACK, [0, 0, 0, 0, 0, 0, 200, 200]).condition_of_counters(), None);
    }

    #[test]
    fn a_change_of_the_condition_alone_is_no_problem() {
        assert!(
            !error(CAN_ERR_CRTL | CAN_ERR_CNT, [0, libc::CAN_ERR_CRTL_TX_PASSIVE as u8, 0, 0, 0, 0, 128, 0])
                .is_problem()
        );
        assert!(!error(CAN_ERR_RESTARTED, [0; 8]).is_problem());
        assert!(error(CAN_ERR_ACK, [0; 8]).is_problem());
        assert!(error(CAN_ERR_CRTL, [0, libc::CAN_ERR_CRTL_RX_OVERFLOW as u8, 0, 0, 0, 0, 0, 0]).is_problem());
        let stuffing = error(CAN_ERR_PROT | CAN_ERR_BUSERROR, [0, 0, libc::CAN_ERR_PROT_STUFF as u8, 0, 0, 0, 0, 0]);
        assert!(stuffing.is_problem() && stuffing.to_string().contains("stuff"), "{stuffing}");
    }
}
