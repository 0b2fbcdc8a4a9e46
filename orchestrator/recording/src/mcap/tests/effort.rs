//! What is read of a damaged file to find what is intact.

use std::cell::Cell;
use std::io::{self, Cursor, Read, Seek, SeekFrom};

use super::*;

/// A file that counts the bytes that are read of it.
struct Metered<'a>(Cursor<&'a [u8]>, &'a Cell<usize>);

impl Read for Metered<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(bytes)?;
        self.1.set(self.1.get() + read);
        Ok(read)
    }
}

impl Seek for Metered<'_> {
    fn seek(&mut self, place: SeekFrom) -> io::Result<u64> {
        self.0.seek(place)
    }
}

#[test]
fn a_file_full_of_heads_that_cover_each_other_is_searched_with_bounded_effort() {
    let one = [handmade::channel(1, 0, "/a"), handmade::message(1, 7, b"a")].concat();
    let one = handmade::chunk(&one, "zstd", [7; 2]);
    // Each head claims all that follows; of chunks, of texts, and of indices of messages.
    let heads: [fn(&mut Vec<u8>, u64); 3] = [
        |bytes, rest| {
            bytes.push(opcode::CHUNK);
            bytes.u64(40 + rest).u64(1).u64(2).u64(rest).u32(1).text("").u64(rest);
        },
        |bytes, rest| {
            bytes.push(opcode::METADATA);
            bytes.u64(8 + rest).text("").u32(rest as u32);
        },
        |bytes, rest| {
            bytes.push(opcode::MESSAGE_INDEX);
            bytes.u64(6 + rest / 16 * 16).u16(1).u32(rest as u32 / 16 * 16);
        },
    ];
    for head in heads {
        let (mut bytes, length) = ([begun(), one.clone()].concat(), 1 << 20);
        while bytes.len() < length {
            let rest = (length - bytes.len()).saturating_sub(60) as u64;
            head(&mut bytes, rest);
        }
        bytes.extend([&[6, 0], &one[..]].concat());
        let read = Cell::new(0);
        let mut reader = McapReader::salvage(Metered(Cursor::new(&bytes), &read)).unwrap();
        let mut messages = 0;
        while reader.next_message().unwrap().is_some() {
            messages += 1;
        }
        assert_eq!(messages, 2);
        assert!(read.get() < 256 << 20, "{} bytes", read.get());
    }
}
