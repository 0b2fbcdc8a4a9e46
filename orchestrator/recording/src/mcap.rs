//! The container format MCAP, version 0: <https://mcap.dev/spec>.
//!
//! A file is a sequence of records: one byte says what it is, eight its length. Messages stand in compressed chunks,
//! each with a checksum; behind the data is a summary, from which readers find the chunks of a time. A file that was
//! cut off has no summary, and is read from its start up to the last whole chunk.
//!
//! Written here instead of used from a crate, because of the cost in the build
//! ([decision 46](../../../docs/decisions/0046-recordings-are-mcap.md)).

mod chunk;
mod damage;
mod fields;
mod reader;
mod writer;

pub use chunk::{Chunk, OpenChunk};
pub use damage::{Damage, ReadError};
pub use reader::{Attachment, Contents, Message, Metadata, Reader};
pub use writer::{Channel, Schema, Writer};

/// First and last bytes of a file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Kinds of records.
pub(crate) mod opcode {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(crate) const STATISTICS: u8 = 0x0b;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const METADATA_INDEX: u8 = 0x0d;
    pub(crate) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// Writes fields of a record.
pub(crate) trait Put {
    /// A number of two bytes.
    fn u16(&mut self, value: u16) -> &mut Self;
    /// A number of four bytes.
    fn u32(&mut self, value: u32) -> &mut Self;
    /// A number of eight bytes.
    fn u64(&mut self, value: u64) -> &mut Self;
    /// A text with its length.
    fn text(&mut self, text: &str) -> &mut Self;
    /// Texts by texts.
    fn map(&mut self, map: &[(String, String)]) -> &mut Self;
}

impl Put for Vec<u8> {
    fn u16(&mut self, value: u16) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.extend(value.to_le_bytes());
        self
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32).extend(text.as_bytes());
        self
    }

    fn map(&mut self, map: &[(String, String)]) -> &mut Self {
        let bytes: usize = map.iter().map(|(key, value)| 8 + key.len() + value.len()).sum();
        self.u32(bytes as u32);
        for (key, value) in map {
            self.text(key).text(value);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> Vec<u8> {
        let schema = Schema { name: "s/msg/S".into(), encoding: "ros2msg".into(), text: "uint8 a".into() };
        let channels = [
            Channel { topic: "one".into(), schema: 0, metadata: vec![] },
            Channel { topic: "two".into(), schema: 0, metadata: vec![("key".into(), "value".into())] },
        ];
        let mut writer = Writer::new(Vec::new(), "test", &[schema], &channels).unwrap();
        writer.attach("a.toml", "application/toml", b"seed = 7\n", 1).unwrap();
        for time in 0..10 {
            writer.message(time as u16 % 2, time, 100 * u64::from(time), &[&[time as u8; 300]]);
            if time % 4 == 3 {
                writer.end_chunk().unwrap();
            }
        }
        writer.metadata("end", &[("lost".into(), "0".into())]).unwrap();
        writer.finish().unwrap().0
    }

    fn read(bytes: &[u8]) -> (Contents, Vec<(String, u64, usize)>) {
        let mut reader = Reader::new(bytes).unwrap();
        let mut messages = Vec::new();
        while let Some(message) = reader.next_message().unwrap() {
            let (channel, log_ns, length) = (message.channel, message.log_ns, message.data.len());
            messages.push((reader.contents().channels[&channel].topic.clone(), log_ns, length));
        }
        (reader.into_contents(), messages)
    }

    #[test]
    fn what_was_written_is_read() {
        let (contents, messages) = read(&file());
        assert_eq!(messages.len(), 10);
        assert_eq!(messages[..2], [("one".to_owned(), 0, 300), ("one".to_owned(), 200, 300)]);
        assert_eq!(contents.attachments[0].data, b"seed = 7\n");
        assert_eq!(contents.metadata[0].name, "end");
        assert!(contents.is_complete);
    }

    #[test]
    fn chunks_that_were_sealed_elsewhere_are_read() {
        let channel = Channel { topic: "one".into(), schema: 0, metadata: vec![] };
        let mut writer = Writer::new(Vec::new(), "test", &[], &[channel]).unwrap();
        let mut open = OpenChunk::default();
        for time in 1..=3 {
            open.message(0, time, u64::from(time), &[&[7; 20], &[8; 10]]);
            writer.chunk(&open.seal().unwrap()).unwrap();
        }
        let (contents, messages) = read(&writer.finish().unwrap().0);
        let expected: Vec<_> = (1..=3).map(|time| ("one".to_owned(), time, 30)).collect();
        assert_eq!((messages, contents.chunks, contents.is_complete), (expected, 3, true));
    }

    #[test]
    fn a_file_that_is_cut_off_anywhere_is_readable_up_to_its_last_whole_chunk() {
        let whole = file();
        let mut longest = 0;
        for length in MAGIC.len()..whole.len() {
            let (contents, messages) = read(&whole[..length]);
            assert!(!contents.is_complete, "{length}");
            assert!(messages.len() >= longest && [0, 4, 8, 10].contains(&messages.len()), "{length}");
            longest = messages.len();
        }
        assert_eq!(longest, 10);
    }

    #[test]
    fn a_flipped_bit_in_a_chunk_is_found() {
        let whole = file();
        let chunk = whole.windows(3).position(|bytes| bytes == b"lz4").unwrap();
        for at in (chunk + 16..chunk + 40).step_by(3) {
            let mut flipped = whole.clone();
            flipped[at] ^= 4;
            let mut reader = Reader::new(&flipped[..]).unwrap();
            let error = loop {
                match reader.next_message() {
                    Ok(Some(_)) => {}
                    Ok(None) => panic!("byte {at}: not found"),
                    Err(error) => break error,
                }
            };
            assert!(matches!(error, ReadError::Damaged { .. }), "{error}");
        }
    }

    #[test]
    fn another_file_is_refused() {
        assert!(matches!(Reader::new(&b"#ROSBAG V2.0"[..]), Err(ReadError::Foreign)));
        assert!(matches!(Reader::new(&b""[..]), Err(ReadError::Foreign)));
    }
}
