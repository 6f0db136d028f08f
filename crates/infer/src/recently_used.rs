//! A store that keeps what was used last, within a bound.

use std::{collections::BTreeMap, sync::Arc};

/// Values that may be needed again, by their keys.
pub struct RecentlyUsed<K, V> {
    entries: BTreeMap<K, Entry<V>>,
    clock: u64,
    bytes: usize,
    capacity: usize,
}

struct Entry<V> {
    used: u64,
    bytes: usize,
    value: Arc<V>,
}

impl<K: Ord + Copy, V> RecentlyUsed<K, V> {
    /// Holds at most `capacity` bytes, but always the value put in last.
    pub fn new(capacity: usize) -> Self {
        Self { entries: BTreeMap::new(), clock: 0, bytes: 0, capacity }
    }

    pub fn get(&mut self, key: K) -> Option<Arc<V>> {
        self.clock += 1;
        let entry = self.entries.get_mut(&key)?;
        entry.used = self.clock;
        Some(entry.value.clone())
    }

    /// Keeps a value of about this many bytes; those that were used longest ago make room for it.
    pub fn put(&mut self, key: K, value: Arc<V>, bytes: usize) {
        self.clock += 1;
        self.bytes += bytes;
        if let Some(old) = self.entries.insert(key, Entry { used: self.clock, bytes, value }) {
            self.bytes -= old.bytes;
        }
        while self.bytes > self.capacity && self.entries.len() > 1 {
            let oldest = self.entries.iter().min_by_key(|(_, entry)| entry.used).map(|(&key, _)| key);
            let Some(old) = oldest.and_then(|key| self.entries.remove(&key)) else { break };
            self.bytes -= old.bytes;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_thousand_values_take_no_more_room_than_a_hundred() {
        let alive = Arc::new(());
        let mut kept = RecentlyUsed::new(50 * 3_000_000);
        let mut most = [0; 2];
        for (number, most) in [100, 10_000].into_iter().zip(&mut most) {
            for key in 0..number {
                // What is asked for again and again stays.
                let first = key / 1000 * 1000;
                if kept.get(first).is_none() || key != first {
                    kept.put(key, Arc::new(alive.clone()), 3_000_000);
                }
                *most = (*most).max(Arc::strong_count(&alive) - 1);
                assert!(kept.get(first).is_some(), "{first} at {key}");
            }
        }
        assert_eq!(most, [50, 50]);
        assert_eq!(kept.bytes, 150_000_000);
        // A value above the bound is kept alone, until the next one.
        kept.put(1, Arc::new(alive.clone()), 1 << 30);
        assert_eq!((kept.entries.len(), Arc::strong_count(&alive)), (1, 2));
        kept.put(2, Arc::new(alive.clone()), 1);
        assert_eq!((kept.bytes, kept.get(1).is_none()), (1, true));
    }
}
