//! Messages of `diagnostic_msgs`.

use serde::Serialize;

use super::message;
use super::time::Header;
use crate::cdr::wire_struct;

wire_struct! {
    /// `diagnostic_msgs/KeyValue`: a named value of a status.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct KeyValue {
        /// Name of the value.
        pub key: String,
        /// The value as text.
        pub value: String,
    }
}

wire_struct! {
    /// `diagnostic_msgs/DiagnosticStatus`: the status of one component.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct DiagnosticStatus {
        /// Severity: one of the constants of this type.
        pub level: u8,
        /// Name of the component.
        pub name: String,
        /// Description of the status.
        pub message: String,
        /// Identifier of the hardware.
        pub hardware_id: String,
        /// Values that belong to the status.
        pub values: Vec<KeyValue>,
    }
}

wire_struct! {
    /// `diagnostic_msgs/DiagnosticArray`: several statuses at one time.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct DiagnosticArray {
        /// `stamp` is the time of the report.
        pub header: Header,
        /// The statuses.
        pub status: Vec<DiagnosticStatus>,
    }
}

message!(DiagnosticArray is "diagnostic_msgs" / "DiagnosticArray",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "diagnostic_msgs/DiagnosticStatus",
    needs "diagnostic_msgs/KeyValue");

impl DiagnosticStatus {
    /// Level: everything is well.
    pub const OK: u8 = 0;
    /// Level: something needs attention.
    pub const WARN: u8 = 1;
    /// Level: something is wrong.
    pub const ERROR: u8 = 2;
    /// Level: no report has come for too long.
    pub const STALE: u8 = 3;
}
