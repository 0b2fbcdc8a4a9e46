//! Files that are made by hand, for tests: what this program does not write, but reads.

use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::{MAGIC, Put, append, opcode};

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    append(&mut bytes, opcode, body);
    bytes
}

/// The start of a file of a program.
pub(crate) fn begun(library: &str) -> Vec<u8> {
    let mut header = Vec::new();
    header.text("").text(library);
    [&MAGIC[..], &record(opcode::HEADER, &header)].concat()
}

pub(crate) fn schema(number: u16, text: &str) -> Vec<u8> {
    let mut body = Vec::new();
    body.u16(number).text("a/msg/A").text("ros2msg").text(text);
    record(opcode::SCHEMA, &body)
}

pub(crate) fn channel(number: u16, schema: u16, topic: &str) -> Vec<u8> {
    let mut body = Vec::new();
    body.u16(number).u16(schema).text(topic).text("cdr").map(&[]);
    record(opcode::CHANNEL, &body)
}

pub(crate) fn message(channel: u16, log_ns: u64, content: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    body.u16(channel).u32(1).u64(log_ns).u64(log_ns).extend_from_slice(content);
    record(opcode::MESSAGE, &body)
}

pub(crate) fn attachment(name: &str, content: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    body.u64(0).u64(0).text(name).text("text/plain").u64(content.len() as u64).extend_from_slice(content);
    let checksum = crc32fast::hash(&body);
    body.u32(checksum);
    record(opcode::ATTACHMENT, &body)
}

/// A chunk whose messages were recorded in these times [ns].
pub(crate) fn chunk(content: &[u8], compression: &str, [first_ns, last_ns]: [u64; 2]) -> Vec<u8> {
    let stored = match compression {
        "zstd" => compress_to_vec(content, CompressionLevel::Fastest),
        _ => content.to_vec(),
    };
    let mut body = Vec::new();
    body.u64(first_ns).u64(last_ns).u64(content.len() as u64).u32(crc32fast::hash(content));
    body.text(compression).u64(stored.len() as u64).extend(stored);
    record(opcode::CHUNK, &body)
}

/// The end of a file whose summary counts nothing.
pub(crate) fn end() -> Vec<u8> {
    [&record(opcode::DATA_END, &[0; 4])[..], &record(opcode::FOOTER, &[0; 20]), &MAGIC].concat()
}

/// The end of a file whose summary counts the messages and attached files, but names no chunk.
pub(crate) fn counted_end(messages: u64, attached: u32, times_ns: [u64; 2]) -> Vec<u8> {
    let mut body = Vec::new();
    body.u64(messages).u16(0).u32(1).u32(attached).u32(0).u32(0).u64(times_ns[0]).u64(times_ns[1]).u32(0);
    let statistics = record(opcode::STATISTICS, &body);
    [&record(opcode::DATA_END, &[0; 4])[..], &statistics, &record(opcode::FOOTER, &[0; 20]), &MAGIC].concat()
}
