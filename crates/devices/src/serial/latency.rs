//! Asks serial drivers for low latency: some hold bytes back for a while, so that the processor is woken less often.

// An ioctl of the serial driver needs it.
#![allow(unsafe_code)]

use std::os::fd::{AsRawFd, BorrowedFd};
use std::path::Path;

use rustix::ioctl::{Getter, Opcode, Setter, ioctl};
use serialport::TTYPort;

/// `struct serial_struct` of linux/serial.h.
#[repr(C)]
#[derive(Clone, Copy)]
struct SerialStruct {
    kind_line_port_irq: [i32; 4],
    flags: i32,
    fifo_divisor_base: [i32; 3],
    close_delay: u16,
    io_type_and_reserved: [u8; 2],
    hub6: i32,
    closing_wait: [u16; 2],
    iomem_base: usize,
    iomem_reg_shift: u16,
    port_high: u32,
    iomap_base: usize,
}

/// TIOCGSERIAL and TIOCSSERIAL of asm-generic/ioctls.h: x86, ARM and RISC-V.
const GET: Opcode = 0x541e;
const SET: Opcode = 0x541f;
/// ASYNC_LOW_LATENCY of linux/tty_flags.h, which every user may set.
const LOW_LATENCY: i32 = 1 << 13;

/// Asks the driver of an open port for low latency. Returns whether it agreed; `None` if it has no such setting.
///
/// FTDI chips wait for 16 ms by default. The udev rules give the file of their timer to the group.
pub(super) fn lower_latency(port: &TTYPort, device: &str) -> Option<bool> {
    match request_low_latency(port) {
        Some(true) => Some(true),
        _ => shorten_timer(device),
    }
}

/// Sets the driver's flag. Returns whether the driver then states it; `None` if the driver refuses the request.
fn request_low_latency(port: &TTYPort) -> Option<bool> {
    // SAFETY: the port outlives this borrow of its descriptor.
    let port = unsafe { BorrowedFd::borrow_raw(port.as_raw_fd()) };
    // SAFETY: this request fills in a `serial_struct`, of which every pattern of bits is a value.
    let get = || unsafe { ioctl(port, Getter::<GET, SerialStruct>::new()) }.ok();
    let mut serial = get()?;
    serial.flags |= LOW_LATENCY;
    // SAFETY: this request reads a `serial_struct`.
    unsafe { ioctl(port, Setter::<SET, SerialStruct>::new(serial)) }.ok()?;
    Some(get()?.flags & LOW_LATENCY != 0)
}

/// Sets the timer of a USB serial chip to 1 ms. Returns whether that worked; `None` if it has no timer.
fn shorten_timer(device: &str) -> Option<bool> {
    let real = std::fs::canonicalize(device).ok()?;
    let timer = Path::new("/sys/bus/usb-serial/devices").join(real.file_name()?).join("latency_timer");
    let now = std::fs::read_to_string(&timer).ok()?;
    Some(now.trim() == "1" || std::fs::write(&timer, "1").is_ok())
}
