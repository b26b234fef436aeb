//! Parses records with the MCAP library after checking the lengths of their strings.
//!
//! The library's parser allocates as much memory as the length of a string claims, up to four gigabytes, before it looks
//! whether the record holds so much.

use mcap::records::{Record, op};

use super::fields::Fields;

/// Parses the body of a record.
pub(super) fn parse_record(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    check_string_lengths(opcode, &mut Fields::new(body)).ok_or("a record that ends within a text or before it")?;
    mcap::parse_record(opcode, body).map_err(|error| error.to_string())
}

/// Returns `None` if a string of the record claims more bytes than the record holds.
fn check_string_lengths(opcode: u8, fields: &mut Fields) -> Option<()> {
    match opcode {
        op::SCHEMA => {
            fields.bytes(2)?;
            skip_string(fields)?;
            skip_string(fields)
        }
        op::CHANNEL => {
            fields.bytes(4)?;
            skip_string(fields)?;
            skip_string(fields)?;
            skip_string_map(fields)
        }
        op::METADATA => {
            skip_string(fields)?;
            skip_string_map(fields)
        }
        op::METADATA_INDEX => {
            fields.bytes(16)?;
            skip_string(fields)
        }
        op::ATTACHMENT_INDEX => {
            fields.bytes(40)?;
            skip_string(fields)?;
            skip_string(fields)
        }
        op::CHUNK_INDEX => {
            fields.bytes(32)?;
            // The map holds pairs of a channel and an offset; the parser reads whole pairs, whatever the length says.
            let length = usize::try_from(fields.u32()?).ok()?;
            fields.bytes(length.checked_next_multiple_of(10)?)?;
            fields.bytes(8)?;
            skip_string(fields)
        }
        _ => Some(()),
    }
}

/// Skips a string.
fn skip_string(fields: &mut Fields) -> Option<()> {
    let length = usize::try_from(fields.u32()?).ok()?;
    fields.bytes(length).map(|_| ())
}

/// Skips a map of strings, which stands behind its length in bytes.
fn skip_string_map(fields: &mut Fields) -> Option<()> {
    let length = usize::try_from(fields.u32()?).ok()?;
    let from = fields.taken();
    while fields.taken() - from < length {
        skip_string(fields)?;
        skip_string(fields)?;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::Cursor;

    use mcap::WriteOptions;

    use super::*;

    /// Writes a log with every kind of record that holds strings, and returns its records.
    fn records() -> Vec<(u8, Vec<u8>)> {
        let mut writer = WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).expect("begun");
        let schema = writer.add_schema("package/msg/Name", "ros2msg", b"int32 x").expect("written");
        let metadata: BTreeMap<String, String> = [("key".to_owned(), "value".to_owned())].into();
        let id = writer.add_channel(schema, "/topic", "cdr", &metadata).expect("written");
        let header = mcap::records::MessageHeader { channel_id: id, sequence: 0, log_time: 1, publish_time: 1 };
        writer.write_to_known_channel(&header, &[0; 8]).expect("written");
        writer.write_metadata(&mcap::records::Metadata { name: "name".to_owned(), metadata }).expect("written");
        let attachment = mcap::Attachment {
            log_time: 1,
            create_time: 1,
            name: "name".to_owned(),
            media_type: "text/plain".to_owned(),
            data: b"abc".as_slice().into(),
        };
        writer.attach(&attachment).expect("written");
        writer.finish().expect("written");
        let log = writer.into_inner().into_inner();
        let mut fields = Fields::new(&log[8..log.len() - 8]);
        let mut records = Vec::new();
        while let Some(opcode) = fields.u8() {
            let length = fields.length().expect("a length");
            records.push((opcode, fields.bytes(length).expect("a body").to_vec()));
        }
        records
    }

    #[test]
    fn a_length_that_no_record_can_hold_takes_no_memory() {
        let holds_strings =
            [op::SCHEMA, op::CHANNEL, op::METADATA, op::METADATA_INDEX, op::ATTACHMENT_INDEX, op::CHUNK_INDEX];
        let records = records();
        for opcode in holds_strings {
            let (_, body) = records.iter().find(|(other, _)| *other == opcode).expect("one of every kind");
            assert!(parse_record(opcode, body).is_ok(), "{opcode:#04x}");
            // The library's parser would allocate first, and then fail with another error.
            let mut noticed = 0;
            for at in 0..body.len() - 4 {
                let mut damaged = body.clone();
                damaged[at..at + 4].copy_from_slice(&0xfff0_0000_u32.to_le_bytes());
                let Err(error) = parse_record(opcode, &damaged) else { continue };
                noticed += u32::from(error.contains("ends within a text"));
            }
            assert!(noticed >= 4, "{opcode:#04x}: {noticed}");
        }
    }
}
