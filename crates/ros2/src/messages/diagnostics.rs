//! diagnostic_msgs.

use serde::Serialize;

use super::message;
use super::time::Header;
use crate::cdr::wire_struct;

wire_struct! {
    /// diagnostic_msgs/KeyValue.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct KeyValue {
        pub key: String,
        pub value: String,
    }
}

wire_struct! {
    /// diagnostic_msgs/DiagnosticStatus.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct DiagnosticStatus {
        /// One of the constants of this type.
        pub level: u8,
        /// What is reported on.
        pub name: String,
        pub message: String,
        pub hardware_id: String,
        pub values: Vec<KeyValue>,
    }
}

wire_struct! {
    /// diagnostic_msgs/DiagnosticArray.
    #[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct DiagnosticArray {
        pub header: Header,
        pub status: Vec<DiagnosticStatus>,
    }
}

message!(DiagnosticArray is "diagnostic_msgs" / "DiagnosticArray",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "diagnostic_msgs/DiagnosticStatus",
    needs "diagnostic_msgs/KeyValue");

impl DiagnosticStatus {
    pub const OK: u8 = 0;
    pub const WARN: u8 = 1;
    pub const ERROR: u8 = 2;
    pub const STALE: u8 = 3;
}
