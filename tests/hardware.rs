//! docs/howto/robot.md says what the wire says.

use mavlink::MessageData;
use mavlink::dialects::common::*;
use realitysim::devices::mavlink::FRAME_OVERHEAD_BYTES;

/// Message, bytes on the wire at most, and how often it is sent a second: the small set, the full set.
fn sets() -> [(&'static str, usize, [usize; 2]); 6] {
    fn of<D: MessageData>(rates_hz: [usize; 2]) -> (&'static str, usize, [usize; 2]) {
        (D::NAME, D::ENCODED_LEN + FRAME_OVERHEAD_BYTES, rates_hz)
    }
    [
        of::<HEARTBEAT_DATA>([1, 1]),
        of::<TIMESYNC_DATA>([4, 4]),
        of::<ATTITUDE_QUATERNION_DATA>([50, 100]),
        of::<ODOMETRY_DATA>([20, 50]),
        of::<GIMBAL_DEVICE_ATTITUDE_STATUS_DATA>([20, 50]),
        of::<HIGHRES_IMU_DATA>([0, 100]),
    ]
}

#[test]
fn the_cost_on_the_wire_is_what_the_table_says() {
    let mut rows = Vec::new();
    for (name, bytes, [small, full]) in sets() {
        rows.push(format!("| {name} | {bytes} | {small} | {full} |"));
    }
    let total = |set: usize| sets().iter().map(|(_, bytes, rates)| bytes * rates[set]).sum::<usize>();
    rows.push(format!("| **bytes a second** | | **{}** | **{}** |", total(0), total(1)));
    for baud in [115_200, 460_800, 921_600] {
        // A start bit, eight bits, a stop bit.
        let share = |set: usize| (total(set) * 10 * 100).div_ceil(baud);
        rows.push(format!("| of {baud} baud | | {} % | {} % |", share(0), share(1)));
    }
    let text = std::fs::read_to_string("docs/howto/robot.md").unwrap();
    for row in rows {
        assert!(text.lines().any(|line| line == row), "docs/howto/robot.md lacks\n{row}");
    }
}
