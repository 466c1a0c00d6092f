//! What was asked once is remembered, in a table of fixed size that all threads share without
//! waiting, and, if it is in a file, other processes too.

use crate::Result;
use crate::math::Rgb;
use crate::run::words::{AtomicLines, Line};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Radiance by key. Where there is no room, later entries take the place of earlier ones.
///
/// The slots that any of some keys may have are a line of the processor's cache, so that it takes
/// no longer to look at all of them.
#[derive(Debug)]
pub(super) struct RadianceCache(AtomicLines);

/// Slots in a line.
const SLOTS: usize = 4;
/// Slots of a table in a file, which frames and tiles of any size may share: 16 MiB.
const FILE_SLOTS: usize = 1 << 20;

/// Slots of a table for about so many entries: 1, 4 or 16 MiB.
fn slots_for(entries: usize) -> usize {
    match entries {
        0..200_000 => 1 << 16,
        200_000..4_000_000 => 1 << 18,
        _ => 1 << 20,
    }
}

impl RadianceCache {
    /// Bytes of a table for about so many entries.
    pub fn bytes_for(entries: usize) -> u64 {
        (slots_for(entries) / SLOTS * size_of::<Line>()) as u64
    }

    /// A table for about so many entries. Each slot is written to before the first look-up, and a
    /// line that is not in the cache of the processor takes longer to read, so that a table has a
    /// slot for each entry only where they are few.
    ///
    /// # Errors
    /// As [`AtomicLines::in_memory`].
    pub fn new(entries: usize) -> Result<Self> {
        let lines = AtomicLines::in_memory(slots_for(entries) / SLOTS)?;
        // Pages of memory that are read before they are written to are mapped twice, the second
        // time in all threads.
        for line in lines.lines() {
            line[0].store(Slot::NO_KEY, Ordering::Relaxed);
        }
        Ok(Self(lines))
    }

    /// A table in a file that processes share, which all enter the same radiance under one key;
    /// `identity` says what that radiance depends on. Entries check themselves: what a torn write
    /// or a damaged file leaves is no entry of any key.
    ///
    /// # Errors
    /// As [`AtomicLines::in_file`].
    pub fn in_file(path: &Path, identity: [u8; 32]) -> Result<Self> {
        AtomicLines::in_file(path, identity, FILE_SLOTS / SLOTS).map(Self)
    }

    /// The line of a key, and the number of its own slot there.
    #[inline]
    fn line(&self, key: u64) -> (&Line, usize) {
        let hash = (key.wrapping_mul(SCATTER) >> 40) as usize;
        let lines = self.0.lines();
        (&lines[(hash / SLOTS) & (lines.len() - 1)], hash % SLOTS)
    }

    /// Tells the processor to have ready what [`Self::get`] will look at.
    #[inline]
    pub fn prefetch(&self, key: u64) {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let line = std::ptr::from_ref(self.line(key).0).cast();
            // SAFETY: the address is that of a reference, and a hint changes nothing that a program
            // can see.
            #[allow(unsafe_code)]
            unsafe {
                _mm_prefetch::<_MM_HINT_T0>(line);
            }
        }
    }

    /// Returns what is kept for a key, which is not 1.
    #[inline]
    pub fn get(&self, key: u64) -> Option<Rgb> {
        let (line, own) = self.line(key);
        let value = Slot::of(line, own).get(key);
        let value = value.or_else(|| Self::elsewhere(line, own, key))?;
        Some(unpack(value))
    }

    /// Looks for a key in the slots that are not its own.
    #[cold]
    fn elsewhere(line: &Line, own: usize, key: u64) -> Option<u64> {
        (1..SLOTS).find_map(|i| Slot::of(line, own ^ i).get(key))
    }

    /// Counts what it holds, which takes reading all of it.
    pub fn entries(&self) -> u64 {
        let in_line = |line: &Line| (0..SLOTS).filter(|&i| !Slot::of(line, i).is_free()).count();
        self.0.lines().iter().map(in_line).sum::<usize>() as u64
    }

    /// Inserts the radiance of a key, in the place of another where the line is full. Returns what
    /// [`Self::get`] will say, which is rounded.
    pub fn insert(&self, key: u64, radiance: Rgb) -> Rgb {
        let (line, own) = self.line(key);
        let value = pack(radiance);
        let free = (0..SLOTS)
            .map(|i| own ^ i)
            .find(|&i| Slot::of(line, i).is_free());
        Slot::of(line, free.unwrap_or(own)).set(key, value);
        unpack(value)
    }
}

/// 2^64 over the golden ratio: the upper bits of a product depend on all bits of the other factor
/// (Fibonacci hashing).
const SCATTER: u64 = 0x9E37_79B9_7F4A_7C15;

/// A key and what belongs to it: the key mixed with the value, then the value, so that halves of
/// two entries written at the same time do not fit each other (Hyatt & Mann 2002).
#[derive(Clone, Copy, Debug)]
struct Slot<'a>(&'a [AtomicU64; 2]);

impl<'a> Slot<'a> {
    /// A key that no patch has: theirs have a leading bit.
    const NO_KEY: u64 = 1;

    #[inline]
    fn of(line: &'a Line, index: usize) -> Self {
        Self(&line.as_chunks::<2>().0[index])
    }

    /// Whether the slot never held anything.
    #[inline]
    fn is_free(self) -> bool {
        [Self::NO_KEY, 0]
            .iter()
            .any(|key| self.get(*key) == Some(0))
    }

    #[inline]
    fn get(self, key: u64) -> Option<u64> {
        let [mixed, value] = self.0.each_ref().map(|v| v.load(Ordering::Relaxed));
        (mixed ^ Self::spread(value) == key).then_some(value)
    }

    #[inline]
    fn set(self, key: u64, value: u64) {
        self.0[0].store(key ^ Self::spread(value), Ordering::Relaxed);
        self.0[1].store(value, Ordering::Relaxed);
    }

    /// Keys and values have a structure, by which one could be taken for another. A product alone
    /// spreads bits upwards only: light of one channel would leave the lower bits of keys as they
    /// are, and halves of two entries could make a third key.
    #[inline]
    fn spread(value: u64) -> u64 {
        let upwards = value.wrapping_mul(SCATTER);
        (upwards ^ upwards >> 32).wrapping_mul(SCATTER)
    }
}

/// Three radiances of at least 0 in 21 bits each: an f32 without its sign and its last ten digits,
/// 6e-5 of its value.
#[inline]
fn pack(c: Rgb) -> u64 {
    // Adding 0 turns -0 into 0.
    let [r, g, b] =
        c.0.map(|v| u64::from(((v + 0.0).to_bits() + (1 << 9)) >> 10));
    r << 42 | g << 21 | b
}

#[inline]
fn unpack(v: u64) -> Rgb {
    Rgb([v >> 42, v >> 21, v].map(|v| f32::from_bits((v as u32 & 0x1f_ffff) << 10)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If each key had one slot, a fifth of those of a table that is half full would have to give
    /// way.
    #[test]
    fn a_table_that_is_half_full_keeps_all_but_few() {
        let cache = RadianceCache::new(0).unwrap();
        let slots = (cache.0.lines().len() * SLOTS) as u64;
        let key = |i: u64| (1 << 33) | (i << 32) | (5 * i);
        let light = |i: u64| Rgb([(i % 1000) as f32, 1.0, 0.0]);
        (0..slots / 2).for_each(|i| assert_eq!(cache.insert(key(i), light(i)), light(i)));
        let kept = |i: &u64| match cache.get(key(*i)) {
            Some(got) => {
                assert_eq!(got, light(*i));
                true
            }
            None => false,
        };
        let count = (0..slots / 2).filter(kept).count() as u64;
        assert!(count > slots / 2 * 95 / 100, "{count} of {}", slots / 2);
        assert_eq!(cache.entries(), count);
        // The last of many more is always there.
        for i in slots / 2..4 * slots {
            cache.insert(key(i), light(i));
            assert!(kept(&i), "{i}");
        }
    }

    #[test]
    fn radiance_survives_packing() {
        for v in [0.0, -0.0, 1e-36, 1e-30, 0.3, 1.0, 7e4, 1e30] {
            let Rgb(got) = unpack(pack(Rgb([v, 2.0 * v, 0.5 * v])));
            for (got, v) in got.into_iter().zip([v, 2.0 * v, 0.5 * v]) {
                assert!((got - v).abs() <= 6.2e-5 * v, "{got} {v}");
            }
        }
    }

    #[test]
    fn a_slot_answers_for_its_key_alone() {
        let words = Default::default();
        let slot = Slot(&words);
        assert_eq!(slot.get(5), None);
        slot.set(5, 77);
        assert_eq!((slot.get(5), slot.get(4)), (Some(77), None));
        // Half of another entry.
        slot.0[1].store(78, Ordering::Relaxed);
        assert_eq!(slot.get(5), None);
    }

    /// Of entries of two triangles whose light has one channel, no half of one with half of the
    /// other makes an entry of any triangle with the same patch: that is all that a key differs by
    /// from others of its table.
    #[test]
    fn halves_of_entries_of_light_of_one_channel_do_not_make_a_third() {
        let sides = [0, 1, 2].map(|c| {
            (1..200).map(move |i| {
                let mut light = [0.0; 3];
                light[c] = 0.37 + 0.01 * i as f32;
                pack(Rgb(light))
            })
        });
        let values: Vec<u64> = sides.into_iter().flatten().collect();
        let patch = 0x1234_5678_u64;
        for (i, &a) in values.iter().enumerate() {
            for &b in &values[..i] {
                let words = Default::default();
                let slot = Slot(&words);
                slot.set(7 << 32 | patch, a);
                slot.0[1].store(b, Ordering::Relaxed);
                let mixed = slot.0[0].load(Ordering::Relaxed);
                let key = mixed ^ Slot::spread(b);
                assert_ne!(key & 0xffff_ffff, patch, "{a:x} {b:x}");
            }
        }
    }
}
