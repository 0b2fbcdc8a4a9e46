//! How one process takes over from another: the stages of a swap, and the comparison with a shadow.

pub mod shadow;
pub mod swap;
