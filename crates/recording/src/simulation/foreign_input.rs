//! Tests of `repair` on what the recorder would not have left: flipped bits, stale copies, foreign files, edited
//! manifests.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::super::folder::manifest_lines;
use super::super::manifest::MANIFEST_FILE;
use super::super::repair::{Repaired, repair};
use super::super::storage::{Storage, write_atomically};
use super::super::verify::verify;
use super::disk::{SimulatedDisk, Trouble};
use super::run::{self, CAPTURES, Run};
use realitysim_ros2::mcap_read::attachments;
use realitysim_ros2::mcap_write::LogWriter;

/// A session that was recorded without trouble.
struct Whole {
    run: Run,
    session: PathBuf,
    /// Content of its first segment.
    content: Vec<u8>,
}

impl Whole {
    fn new() -> Self {
        let run = Run::new(3, Trouble::default()).until_the_end();
        let session = run::session(&run.disk).unwrap();
        let content = run.disk.snapshot()[&session.join("0000.mcap")].clone();
        Self { run, session, content }
    }

    /// A disk with the session and this content as its only segment, never finished.
    fn with_active(&self, content: &[u8]) -> SimulatedDisk {
        let disk = SimulatedDisk::new(0, Trouble::default());
        run::put(&disk, CAPTURES, &self.session, &self.run.disk, content);
        disk
    }

    /// A disk with the session as it was recorded.
    fn recorded(&self) -> SimulatedDisk {
        let disk = SimulatedDisk::new(0, Trouble::default());
        disk.create_folder(Path::new(CAPTURES)).unwrap();
        disk.create_folder(&self.session).unwrap();
        for (path, content) in self.run.disk.snapshot() {
            if path.parent() == Some(self.session.as_path()) {
                self.put(&disk, path.file_name().unwrap().to_str().unwrap(), &content);
            }
        }
        disk
    }

    fn put(&self, disk: &SimulatedDisk, name: &str, content: &[u8]) {
        // `write_atomically` cannot be used: it replaces the name's ending for its temporary file.
        let file = disk.create_over(&self.session.join(name)).unwrap();
        let mut written = 0;
        while written < content.len() {
            written += file.write(&content[written..]).unwrap();
        }
    }

    fn repair(&self, disk: &SimulatedDisk) -> Repaired {
        let repaired = repair(disk, &self.session).unwrap();
        assert!(repair(disk, &self.session).unwrap().changed_nothing());
        assert!(verify(disk, &self.session).unwrap().wrong.is_empty());
        repaired
    }

    fn get(&self, disk: &SimulatedDisk, name: &str) -> Option<Vec<u8>> {
        disk.snapshot().remove(&self.session.join(name))
    }
}

#[test]
fn damage_before_the_chunks_of_an_unfinished_segment_costs_no_chunk() {
    let whole = Whole::new();
    let messages = run::read_file(&whole.run.disk, &whole.session.join("0000.mcap")).len();
    let first_chunk = chunks(&whole.content)[0];
    assert!(first_chunk > 60 && messages > 10, "{first_chunk} {messages}");
    // This covers the lengths of header and attachment, and everything between. A wrong length may fit into the file.
    for byte in 8..first_chunk {
        for bit in [0, 2, 5] {
            let mut damaged = whole.content.clone();
            damaged[byte] ^= 1 << bit;
            let disk = whole.with_active(&damaged[..damaged.len() - 40]);
            let repaired = repair(&disk, &whole.session).unwrap();
            assert!(repaired.removed.is_empty(), "byte {byte} bit {bit}: {repaired:?}");
            let there = run::read_file(&disk, &whole.session.join("0000.mcap")).len();
            assert_eq!(there, messages, "byte {byte} bit {bit}: {repaired:?}");
        }
    }
    let mut cut = whole.content.clone();
    cut.drain(first_chunk - 30..first_chunk - 10);
    let disk = whole.with_active(&cut);
    assert!(repair(&disk, &whole.session).unwrap().removed.is_empty());
    assert_eq!(run::read_file(&disk, &whole.session.join("0000.mcap")).len(), messages);
}

/// Attachments are compared as well, since a replay starts from them.
#[test]
fn a_changed_byte_in_an_unlisted_segment_is_told_or_harmless() {
    let whole = Whole::new();
    let path = whole.session.join("0000.mcap");
    let read = |disk: &SimulatedDisk| {
        let attachments = attachments(disk.read(&path).unwrap()).unwrap().list;
        let messages: Vec<_> = run::read_file(disk, &path).into_iter().map(|message| message.data).collect();
        (attachments, messages)
    };
    let right = read(&whole.recorded());
    assert!(!right.0.is_empty());
    for byte in (8..whole.content.len() - 8).step_by(7) {
        let mut rotten = whole.content.clone();
        rotten[byte] ^= 4;
        let disk = whole.recorded();
        disk.remove(&whole.session.join(MANIFEST_FILE)).unwrap();
        whole.put(&disk, "0000.mcap", &rotten);
        let repaired = repair(&disk, &whole.session).unwrap();
        assert!(!repaired.lost.is_empty() || read(&disk) == right, "byte {byte}: {repaired:?}");
    }
}

#[test]
fn segments_of_another_session_are_left_alone_and_named() {
    let whole = Whole::new();
    let written = |id: Option<&str>| {
        let mut writer = LogWriter::new(Vec::new()).unwrap();
        if let Some(id) = id {
            let hash = blake3::hash(id.as_bytes()).to_hex()[..16].to_owned();
            let values = BTreeMap::from([("id".to_owned(), id.to_owned()), ("blake3".to_owned(), hash)]);
            writer.metadata("realitysim.session", &values).unwrap();
        }
        for message in run::read_file(&whole.run.disk, &whole.session.join("0000.mcap")) {
            let channel = writer.add_raw_channel(&message.channel.as_ref().into()).unwrap();
            writer
                .write(channel, message.sequence, message.log_time_ns, message.publish_time_ns, &message.data)
                .unwrap();
        }
        writer.finish().unwrap()
    };
    for (content, why) in
        [(written(Some("0123")), "of the session with id 0123"), (written(None), "not written by this")]
    {
        let disk = whole.recorded();
        let before = manifest_lines(&disk, &whole.session).unwrap();
        whole.put(&disk, "0907.mcap", &content);
        let repaired = repair(&disk, &whole.session).unwrap();
        assert!(repaired.to_string().contains(why) && repaired.listed.is_empty(), "{repaired:?}");
        assert_eq!(manifest_lines(&disk, &whole.session).unwrap(), before);
        assert_eq!(whole.get(&disk, "0907.mcap").as_ref(), Some(&content), "left alone");

        let disk = whole.recorded();
        whole.put(&disk, "0907.mcap.active", &content);
        let repaired = repair(&disk, &whole.session).unwrap();
        assert!(repaired.to_string().contains(why) && repaired.finished.is_empty(), "{repaired:?}");
        assert_eq!(whole.get(&disk, "0907.mcap.damaged").as_ref(), Some(&content), "set aside");
    }
}

#[test]
fn a_chunk_s_head_that_is_overwritten_costs_that_chunk_alone() {
    let whole = Whole::new();
    let path = whole.session.join("0000.mcap");
    let messages = run::read_file(&whole.run.disk, &path).len();
    let chunks = chunks(&whole.content);
    let mut damaged = whole.content.clone();
    damaged[chunks[1]..chunks[1] + 30].fill(0);
    let disk = whole.with_active(&damaged);
    let repaired = whole.repair(&disk);
    let left = run::read_file(&disk, &path).len();
    assert!(left < messages && left > messages / 2 && repaired.lost.len() == 1, "{left} of {messages}: {repaired:?}");
    assert!(whole.get(&disk, "0000.mcap.damaged").is_some_and(|kept| kept == damaged), "{repaired:?}");
}

#[test]
fn what_gives_no_message_goes_only_if_it_is_the_beginning_of_a_log() {
    let whole = Whole::new();
    let first_chunk = chunks(&whole.content)[0];
    let mut beheaded = whole.content.clone();
    beheaded[..512].fill(0);
    let mut all_bad = whole.content[..chunks(&whole.content)[1]].to_vec();
    all_bad[first_chunk + 60] ^= 1;
    for kept in [b"a text of mine".to_vec(), vec![7; 3000], beheaded, all_bad] {
        let disk = whole.with_active(&kept);
        let repaired = whole.repair(&disk);
        assert_eq!((repaired.lost.len(), repaired.removed.len()), (1, 0), "{repaired:?}");
        assert_eq!(whole.get(&disk, "0000.mcap.damaged"), Some(kept));
        let said = repaired.to_string();
        assert!(said.contains("set aside: ") && said.contains("0000.mcap.damaged: no message in it"), "{said}");
    }
    let begun = &whole.content[..first_chunk];
    for gone in [Vec::new(), vec![0; 5000], begun.to_vec(), begun[..20].to_vec(), [begun, &[0; 700]].concat()] {
        let disk = whole.with_active(&gone);
        let repaired = whole.repair(&disk);
        assert_eq!((repaired.lost.len(), repaired.removed.len()), (0, 1), "{repaired:?}");
    }
    // A chunk that was begun held something.
    let disk = whole.with_active(&whole.content[..first_chunk + 50]);
    let repaired = whole.repair(&disk);
    assert_eq!((repaired.lost.len(), repaired.removed.len()), (1, 1), "{repaired:?}");
    assert!(repaired.lost[0].what.starts_with("50 bytes of it could not be kept"), "{repaired:?}");
}

#[test]
fn a_finished_segment_is_never_replaced_nor_is_what_was_set_aside() {
    let whole = Whole::new();
    let stale = &whole.content[..whole.content.len() / 2];
    for forgotten in [false, true] {
        let disk = whole.recorded();
        whole.put(&disk, "0000.mcap.active", stale);
        whole.put(&disk, "0000.mcap.damaged", b"somebody's");
        if forgotten {
            whole.put(&disk, MANIFEST_FILE, b"");
        }
        let repaired = whole.repair(&disk);
        assert!(repaired.lost.is_empty() && repaired.set_aside.len() == 1, "{repaired:?}");
        assert!(whole.get(&disk, "0000.mcap").unwrap() == whole.content, "{repaired:?}");
        assert_eq!(whole.get(&disk, "0000.mcap.damaged").unwrap(), b"somebody's");
        assert_eq!(whole.get(&disk, "0000.mcap.damaged-2").unwrap(), stale);
        assert_eq!(repaired.listed.is_empty(), !forgotten);
    }
}

#[test]
fn a_damaged_line_of_a_manifest_is_mended_or_told() {
    let whole = Whole::new();
    let lines = manifest_lines(&whole.run.disk, &whole.session).unwrap();
    assert!(lines.len() > 2, "{lines:?}");
    let text = String::from_utf8(whole.get(&whole.run.disk, MANIFEST_FILE).unwrap()).unwrap();
    let rows: Vec<&str> = text.lines().collect();
    let wrong = |disk: &SimulatedDisk| verify(disk, &whole.session).unwrap().wrong.len();
    let with = |manifest: String, is_gone: Option<&str>| {
        let disk = whole.recorded();
        write_atomically(&disk, &whole.session.join(MANIFEST_FILE), manifest.as_bytes()).unwrap();
        if let Some(name) = is_gone {
            disk.remove(&whole.session.join(name)).unwrap();
        }
        disk
    };
    let damaged_row = |row: &str| text.replace(row, &format!("#{row}"));
    let unreadable_row = |row: &str| text.replace(row, &"\0".repeat(row.len()));
    let last = rows.last().unwrap();
    let last_name = lines.last().unwrap().name.clone();
    let torn = |bytes: usize| format!("{}{}", text.strip_suffix(&format!("{last}\n")).unwrap(), &last[..bytes]);
    for (manifest, gone, lost, told) in [
        (damaged_row(rows[1]), Some(lines[1].name.as_str()), 1, true),
        (unreadable_row(rows[1]), Some(&lines[1].name), 1, true),
        (torn(60), Some(&last_name), 1, true),
        (damaged_row(rows[1]), None, 0, true),
        (unreadable_row(rows[1]), None, 0, true),
        (torn(60), None, 0, true),
        (torn(3), None, 0, true),
        (text.clone(), None, 0, false),
    ] {
        let disk = with(manifest.clone(), gone);
        assert_eq!(wrong(&disk) > 0, told, "{manifest}");
        let repaired = whole.repair(&disk);
        assert_eq!(repaired.lost.len(), lost, "{manifest}\n{repaired:?}");
    }
}

/// Positions of the chunks of a log.
fn chunks(log: &[u8]) -> Vec<usize> {
    let mut found = Vec::new();
    let mut at = 8;
    while at + 9 <= log.len() {
        if log[at] == 6 {
            found.push(at);
        }
        at += 9 + u64::from_le_bytes(log[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    found
}
