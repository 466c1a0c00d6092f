//! Trees that are open for use: what a tree file holds, decoded page by page when a ray first
//! needs it.
//!
//! A path enters, an [`OpenTree`] leaves: surfels below the nodes of pages ([`SurfelStore`]), and
//! lvoxels in memory ([`Media`]). No scene is needed.
//!
//! | file | what it does |
//! | --- | --- |
//! | `open_tree` | opens a file, within a limit on memory |
//! | `pages` | pages that stay resident, or live in a cache of bounded size |
//! | `decoder` | decodes pages, and counts them |
//! | `page` | the layout of a decoded page: eight children, eight disks at a time |
//! | `node_aggregate` | what stands for the surfels below a node |
//! | `evenness` | whether it says so much like those below that nobody need look at them |
//! | `aggregate_sums` | the sums over surfels that nodes are made of |
//! | `traversal` | the way of all queries through the nodes |
//! | `media` | lvoxels, and the walk of a ray through them |

mod aggregate_sums;
mod decoder;
mod evenness;
pub(crate) mod media;
pub(crate) mod node_aggregate;
mod open_tree;
pub(crate) mod page;
pub(crate) mod pages;
pub(crate) mod traversal;

pub use aggregate_sums::AggregateSums;
pub use decoder::PageStats;
pub(crate) use evenness::{MISLEADING_DIFFERENCE, is_even};
pub(crate) use media::{IncidentGrid, LvoxelBlock, Media};
pub use open_tree::{OpenTree, TreeNeeds};
pub(crate) use pages::{Page, SurfelStore};
