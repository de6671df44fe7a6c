//! What a page may read of a folder's sessions, which [`crate::catalogue`] lists.
//!
//! - [`SessionPages`]: the list, with pictures that were made;
//! - [`comparison`]: two or more fits, of any sessions;
//! - [`detail`]: everything that a page shows of one session;
//! - [`files`]: which files of a session may be read; [`served`]: what a page gets;
//! - [`exports`]: what exports make;
//! - [`pictures`]: images of a session as PNG;
//! - [`routes()`] and [`action_routes`]: the addresses.

mod actions;
pub mod comparison;
pub mod detail;
pub mod exports;
pub mod files;
mod pages;
pub mod pictures;
mod routes;
pub mod served;
#[cfg(test)]
mod tests;

pub use actions::action_routes;
pub use pages::SessionPages;
pub use routes::routes;
