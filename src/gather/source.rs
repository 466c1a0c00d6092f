//! Where pages come from: all in memory, or decoded on demand into a cache of bounded size.

use super::page::KernelPage;
use std::ops::Deref;

/// Gives pages to the kernels.
pub trait Pages: Sync {
    /// What holds a page while it is used.
    type Guard<'a>: Deref<Target = KernelPage>
    where
        Self: 'a;

    /// The page at which every ray starts; `None` for a tree without surfels.
    fn root(&self) -> Option<u32>;

    /// A page. A page that cannot be read is given as empty, and the failure is kept for the caller of the kernel.
    fn page(&self, id: u32) -> Self::Guard<'_>;
}

/// All pages of a tree in memory.
#[derive(Debug, Default)]
pub struct ResidentTree {
    root: Option<u32>,
    pages: Vec<KernelPage>,
}

impl ResidentTree {
    /// Takes pages whose ids are their indices.
    #[must_use]
    pub fn new(root: Option<u32>, pages: Vec<KernelPage>) -> Self {
        Self { root, pages }
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.pages.iter().map(KernelPage::bytes).sum()
    }
}

impl Pages for ResidentTree {
    type Guard<'a> = &'a KernelPage;

    fn root(&self) -> Option<u32> {
        self.root
    }

    #[inline]
    fn page(&self, id: u32) -> &KernelPage {
        &self.pages[id as usize]
    }
}
