//! Identities of sessions and robots. Names can be equal and folders can be renamed; these identities stay.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::manifest::FORMAT_VERSION;

/// What another machine needs of a `session.json`, whatever settings its writer has: unknown keys are ignored.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Head {
    /// Version of the format.
    pub format: u32,
    /// Name of the robot.
    pub robot: String,
    /// UTC of the first message, RFC 3339.
    pub started: String,
    #[serde(default)]
    id: Option<String>,
    #[serde(default)]
    live: Option<LiveHead>,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
struct LiveHead {
    #[serde(default)]
    robot_id: Option<String>,
}

/// Identity of a session: 32 hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(transparent)]
pub struct SessionId(String);

/// Length of an identity, bytes.
const ID_BYTES: usize = 16;

impl Head {
    /// Parses the content of a `session.json`; the error says what is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        #[derive(Deserialize)]
        struct Version {
            format: u32,
        }
        let Version { format } = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        if format != FORMAT_VERSION {
            return Err(format!("written in format {format}, and this program knows {FORMAT_VERSION} only"));
        }
        serde_json::from_slice(bytes).map_err(|error| error.to_string())
    }

    /// Identity of the session; for a `session.json` without one, a hash of its content, `bytes`.
    pub fn id(&self, bytes: &[u8]) -> SessionId {
        match &self.id {
            Some(id) if is_id(id) => SessionId(id.clone()),
            _ => SessionId(hex(&blake3::hash(bytes).as_bytes()[..ID_BYTES])),
        }
    }

    /// Identity of the machine that recorded; `None` for a replay.
    pub fn robot_id(&self) -> Option<&str> {
        self.live.as_ref()?.robot_id.as_deref().filter(|id| is_id(id))
    }
}

impl SessionId {
    /// Makes the identity of a session that begins.
    pub fn new() -> Self {
        let mut bytes = [0; ID_BYTES];
        match rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty()) {
            Ok(ID_BYTES) => {}
            // Where the kernel gives no random bytes, time and process number are unique enough among a team's
            // sessions.
            _ => {
                let now = jiff::Timestamp::now().as_nanosecond().to_le_bytes();
                let seed = [now.as_slice(), &std::process::id().to_le_bytes()].concat();
                bytes.copy_from_slice(&blake3::hash(&seed).as_bytes()[..ID_BYTES]);
            }
        }
        Self(hex(&bytes))
    }

    /// The 32 hexadecimal digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The first six digits, enough to tell folders of one name apart.
    pub fn short(&self) -> &str {
        &self.0[..6]
    }
}

impl Default for SessionId {
    fn default() -> Self {
        Self::new()
    }
}

fn is_id(text: &str) -> bool {
    text.len() == 2 * ID_BYTES && text.bytes().all(|byte| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Identity of this machine, which stays as long as its system and its disks do.
///
/// Robots that were set up from one image differ in their disks. The identity is a hash, since the numbers of the
/// parts are private.
pub fn robot_id() -> String {
    robot_id_under(Path::new("/"))
}

/// Does the same as [`robot_id`] for a file system under `root`.
fn robot_id_under(root: &Path) -> String {
    let mut parts: Vec<Vec<u8>> = ["etc/machine-id", "sys/firmware/devicetree/base/serial-number"]
        .iter()
        .filter_map(|file| std::fs::read(root.join(file)).ok())
        .collect();
    let mut disks: Vec<Vec<u8>> = Vec::new();
    for disk in std::fs::read_dir(root.join("sys/block")).into_iter().flatten().flatten() {
        let disk = disk.path();
        let comes_and_goes = std::fs::read(disk.join("removable")).is_ok_and(|text| text.starts_with(b"1"))
            || disk.canonicalize().is_ok_and(|path| path.to_string_lossy().contains("/usb"));
        if !comes_and_goes {
            disks.extend(
                ["device/cid", "wwid", "device/wwid"].iter().filter_map(|file| std::fs::read(disk.join(file)).ok()),
            );
        }
    }
    disks.sort();
    parts.extend(disks);
    let mut hasher = blake3::Hasher::new_derive_key("realitysim robot id");
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes()).update(&part);
    }
    hex(&hasher.finalize().as_bytes()[..ID_BYTES])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_keeps_its_number_and_one_without_has_that_of_its_file() {
        let id = SessionId::new();
        assert_ne!(id, SessionId::new());
        let with = format!(r#"{{"format":1,"robot":"r","started":"t","id":"{}","other":[1]}}"#, id.as_str());
        assert_eq!(Head::parse(with.as_bytes()).unwrap().id(with.as_bytes()), id);
        let without = br#"{"format":1,"robot":"r","started":"t","id":"../../x"}"#;
        let head = Head::parse(without).unwrap();
        assert!(is_id(head.id(without).as_str()), "what is no number is not taken for one");
        assert_ne!(head.id(without), head.id(b"another file"));
    }

    #[test]
    fn another_version_is_named() {
        let said = Head::parse(br#"{"format":2,"anything":true}"#).unwrap_err();
        assert_eq!(said, "written in format 2, and this program knows 1 only");
        Head::parse(b"\0\0\0").unwrap_err();
        Head::parse(br#"{"format":1}"#).unwrap_err();
    }

    #[test]
    fn robots_of_one_image_differ_by_their_disks_and_not_by_their_sticks() {
        let robot = |card: &str, stick: &str| {
            let root = tempfile::tempdir().unwrap();
            let write = |path: &str, text: &str| {
                let path = root.path().join(path);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, text).unwrap();
            };
            write("etc/machine-id", "0123\n");
            write("sys/block/mmcblk0/removable", "0\n");
            write("sys/block/mmcblk0/device/cid", card);
            write("sys/block/sda/removable", "1\n");
            write("sys/block/sda/device/wwid", stick);
            robot_id_under(root.path())
        };
        assert_eq!(robot("a", "x"), robot("a", "y"));
        assert_ne!(robot("a", "x"), robot("b", "x"));
        assert!(is_id(&robot_id()));
    }
}
