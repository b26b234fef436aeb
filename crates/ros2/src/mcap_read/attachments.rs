//! Attachments and metadata records, which a log holds beside its messages.

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::{Record as Parsed, op};

use super::channels::{Channels, Selection};
use super::chunk::nanoseconds;
use super::error::{Damage, MAGIC, ReadError};
use super::fields::Fields;
use super::lengths::parse_record;
use super::source::{Record, Source};
use super::summary::Summary;

/// Largest attachment that is read or written, bytes.
pub const MAX_ATTACHMENT_BYTES: u64 = 64 << 20;

/// Largest size of all attachments that are read together, bytes.
const MAX_ATTACHMENTS_BYTES: u64 = 4 * MAX_ATTACHMENT_BYTES;

/// Largest size of all metadata records that are read together, bytes; a record beyond it is left out.
pub(super) const MAX_METADATA_BYTES: u64 = 16 << 20;

/// Largest number of records that a walk remembers; as many chunks of a megabyte make a terabyte.
const MAX_WALKED_RECORDS: usize = 1 << 20;

/// An attachment: a file inside the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// Name of the file.
    pub name: String,
    /// MIME type of the data.
    pub media_type: String,
    /// Time at which it was logged, nanoseconds.
    pub log_time_ns: i64,
    /// Content of the file.
    pub data: Vec<u8>,
}

/// A metadata record: key-value pairs about the log as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetadataRecord {
    /// Name of the record.
    pub name: String,
    /// Values by key.
    pub values: BTreeMap<String, String>,
}

/// The attachments of a log, as far as they are sound and not too large.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attachments {
    /// Attachments in the order of the file.
    pub list: Vec<Attachment>,
    /// Damage of attachments, and of the records between them.
    pub damage: Damage,
}

/// Reads all attachments of a log, finished or not.
pub fn attachments<R: Read + Seek>(reader: R) -> Result<Attachments, ReadError> {
    let mut source = Source::open(reader)?;
    let mut damage = Damage { torn: !source.ends_with_magic()?, ..Damage::default() };
    // Damage of the summary is not counted: without a summary a walk finds the attachments.
    let summary = Summary::read(&mut source, &mut Channels::new(Selection::default()), &mut Damage::default())?;
    let records = find_side_records(summary.as_ref(), &mut source, &mut damage)?;
    let list = read_sound_attachments(&mut source, &records, &mut damage)?;
    Ok(Attachments { list, damage })
}

/// Reads the attachments among these records, and counts those that are damaged or too large.
pub(super) fn read_sound_attachments<R: Read + Seek>(
    source: &mut Source<R>,
    records: &[Record],
    damage: &mut Damage,
) -> Result<Vec<Attachment>, ReadError> {
    let mut list = Vec::new();
    let mut total = 0;
    for record in records.iter().filter(|record| record.opcode == op::ATTACHMENT) {
        total += record.length;
        let mut body = Vec::new();
        let parsed = if record.length > MAX_ATTACHMENT_BYTES || total > MAX_ATTACHMENTS_BYTES {
            total -= record.length;
            Err(format!("attachment: expected at most {MAX_ATTACHMENT_BYTES} bytes, found {}", record.length))
        } else if source.read_at(record.body(), record.length, &mut body)? {
            parse_attachment(&body)
        } else {
            Err("attachment: found the end of the file".to_owned())
        };
        match parsed {
            Ok(attachment) => list.push(attachment),
            Err(error) => damage.bad_record(record.offset, record.bytes(), &error),
        }
    }
    Ok(list)
}

/// Finds the records of attachments and metadata: by the summary, or else by a walk over the heads of all records.
pub(super) fn find_side_records<R: Read + Seek>(
    summary: Option<&Summary>,
    source: &mut Source<R>,
    damage: &mut Damage,
) -> Result<Vec<Record>, ReadError> {
    if let Some(summary) = summary
        && let Some(records) = summary.side_records(source)?
    {
        return Ok(records);
    }
    walk_records(source, &[op::ATTACHMENT, op::METADATA], damage)
}

/// Finds the records of some kinds by a walk over the heads of all records; their bodies are not read.
pub(super) fn walk_records<R: Read + Seek>(
    source: &mut Source<R>,
    opcodes: &[u8],
    damage: &mut Damage,
) -> Result<Vec<Record>, ReadError> {
    let mut found = Vec::new();
    let mut position = MAGIC.len() as u64;
    while position < source.length() {
        match source.record_at(position)? {
            Ok(record) if matches!(record.opcode, op::DATA_END | op::FOOTER) => break,
            Ok(record) => {
                if opcodes.contains(&record.opcode) {
                    if found.len() == MAX_WALKED_RECORDS {
                        damage.note(|| format!("expected at most {MAX_WALKED_RECORDS} attachments or chunks"));
                        break;
                    }
                    found.push(record);
                }
                position = record.end();
            }
            Err(error) => {
                damage.bytes_skipped += source.length() - position;
                damage.note(|| format!("record at byte {position}: {error}"));
                break;
            }
        }
    }
    Ok(found)
}

/// Reads the name of an attachment, but not its data.
pub(super) fn read_attachment_name<R: Read + Seek>(
    source: &mut Source<R>,
    record: &Record,
) -> Result<Option<String>, ReadError> {
    /// Largest size of the fields before the data, bytes: two times and two strings.
    const MAX_HEAD_BYTES: u64 = 64 << 10;
    let mut head = Vec::new();
    source.read_at(record.body(), record.length.min(MAX_HEAD_BYTES), &mut head)?;
    let mut fields = Fields::new(&head);
    Ok((|| {
        fields.u64()?;
        fields.u64()?;
        fields.string().map(str::to_owned)
    })())
}

/// Reads the metadata among these records, and counts those that are damaged or too large.
pub(super) fn read_metadata<R: Read + Seek>(
    source: &mut Source<R>,
    records: &[Record],
    damage: &mut Damage,
) -> Result<Vec<MetadataRecord>, ReadError> {
    let mut found = Vec::new();
    let mut total = 0;
    for record in records.iter().filter(|record| record.opcode == op::METADATA) {
        total += record.length;
        let mut body = Vec::new();
        if total > MAX_METADATA_BYTES || !source.read_at(record.body(), record.length, &mut body)? {
            total -= record.length;
            damage.bad_record(record.offset, record.bytes(), "metadata that is too large");
            continue;
        }
        match parse_record(op::METADATA, &body) {
            Ok(Parsed::Metadata(record)) => found.push(MetadataRecord { name: record.name, values: record.metadata }),
            Ok(_) => {}
            Err(error) => damage.bad_record(record.offset, record.bytes(), &format!("metadata: {error}")),
        }
    }
    Ok(found)
}

/// Parses the body of an attachment record and verifies its checksum.
pub(super) fn parse_attachment(body: &[u8]) -> Result<Attachment, String> {
    let mut fields = Fields::new(body);
    let mut parse = || {
        let log_time_ns = nanoseconds(fields.u64()?);
        fields.u64()?;
        let (name, media_type) = (fields.string()?.to_owned(), fields.string()?.to_owned());
        let length = fields.length()?;
        let data = fields.bytes(length)?.to_vec();
        let checked = fields.taken();
        Some((Attachment { name, media_type, log_time_ns, data }, checked, fields.u32()?))
    };
    let (attachment, checked, crc) = parse().ok_or("attachment: it is cut")?;
    let calculated = crc32fast::hash(&body[..checked]);
    if crc != 0 && crc != calculated {
        return Err(format!(
            "attachment {:?}: expected the checksum {crc:08x}, found {calculated:08x}",
            attachment.name
        ));
    }
    Ok(attachment)
}
