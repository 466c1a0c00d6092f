//! Trees that are open for use: what a tree file holds, decoded page by page when a ray first
//! needs it.
//!
//! A path enters, an [`OpenTree`] leaves: surfels below the nodes of pages ([`SurfelStore`]), and
//! lvoxels in memory ([`Media`]). No scene is needed.
//!
//! | file | what it does |
//! | --- | --- |
//! | `store` | pages that stay resident, or live in a cache of bounded size |
//! | `page` | the layout of a decoded page: eight children, eight disks at a time |
//! | `node_aggregate` | what stands for the surfels below a node |
//! | `media` | lvoxels, and the walk of a ray through them |

pub(crate) mod media;
pub(crate) mod node_aggregate;
pub(crate) mod page;
pub(crate) mod store;

pub use media::Media;
pub use node_aggregate::NodeAggregate;
pub use store::{CachedTree, OpenTree, Page, PageStats, Pages, ResidentTree, SurfelStore};
