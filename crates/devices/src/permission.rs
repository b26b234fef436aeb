//! Tells who may open a device, and what to do without permission.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Returns the group whose members may open a device; `None` where only root may.
pub fn group_of(device: &Path) -> Option<String> {
    let device = std::fs::metadata(device).ok()?;
    let group = device.gid();
    if group == 0 || device.mode() & READ_AND_WRITE != READ_AND_WRITE {
        return None;
    }
    let groups = std::fs::read_to_string("/etc/group").ok()?;
    Some(group_name(&groups, group).map_or_else(|| group.to_string(), str::to_owned))
}

/// Bits of a file's mode that let its group read and write.
const READ_AND_WRITE: u32 = 0o060;

/// Finds the name of a group by its number in the lines of /etc/group, see group(5).
fn group_name(groups: &str, group: u32) -> Option<&str> {
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(group)).then_some(name)
    })
}

/// Says what to do without permission. `usual` is the group that udev gives such devices to.
pub fn remedy(device: &Path, usual: &str) -> String {
    match group_of(device) {
        Some(group) => format!("your user must be in the group {group}: sudo usermod -aG {group} $USER"),
        None => format!("it is root's alone: a udev rule must give it to the group {usual}, and your user be in that"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_has_a_name() {
        let groups = "root:x:0:\ndialout:x:20:soccer,coach\nvideo:x:44:\nbroken\n";
        assert_eq!(group_name(groups, 20), Some("dialout"));
        assert_eq!(group_name(groups, 44), Some("video"));
        assert_eq!(group_name(groups, 45), None);
    }

    #[test]
    fn root_s_devices_are_nobody_s_by_a_group() {
        assert!(remedy(Path::new("/"), "video").contains("a udev rule must give it to the group video"));
    }
}
