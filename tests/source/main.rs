//! The source itself: floors of modules, links of documents, quotations of advice.
mod docs_links;
mod floors;
mod hints;
