//! The sessions of one folder: which there are, what became of them, and what of them a page
//! may read.
//!
//! - [`Catalogue`]: the list, newest first, kept in memory by the files' times;
//! - [`row`]: one line of the list;
//! - [`detail`]: everything that a page shows of one session;
//! - [`files`]: which files of a session may be read; [`served`]: what a page gets;
//! - [`pictures`]: images of a session as PNG;
//! - [`routes()`] and [`action_routes`]: the addresses.

mod actions;
pub mod detail;
pub mod files;
mod list;
pub mod pictures;
mod routes;
pub mod row;
pub mod served;
#[cfg(test)]
mod tests;

pub use actions::action_routes;
pub use list::Catalogue;
pub use routes::routes;
