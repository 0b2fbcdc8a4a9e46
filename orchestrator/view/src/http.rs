//! The part of HTTP/1.1 that the page needs: one request per connection, with limits of size and time.

mod reading;
mod request;
mod response;

pub(crate) use reading::{Failed, read_request};
pub(crate) use request::{Method, Request};
pub(crate) use response::{Response, Status, write_stream_head};
