//! How one process takes over from another: the stages of a swap, and the comparison of a shadow with the live one.

pub mod companion;
pub mod shadow;
pub mod swap;
