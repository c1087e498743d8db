//! Threads: two threads work through a list.

use std::sync::{Mutex, PoisonError};

/// Works on the items in two threads, this one and another, and returns the outcomes in the items' order. Each thread
/// makes its own tool and takes the next item when it is done with one.
pub(super) fn side_by_side<A, S, T: Send>(
    items: impl Iterator<Item = A> + Send,
    tool: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, A) -> T + Sync,
) -> Vec<T> {
    let queue = Mutex::new(items.enumerate());
    let take = || {
        let (mut done, mut tool) = (Vec::new(), tool());
        loop {
            // A lock in its own statement: it is released while the item is worked on.
            let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
            match next {
                Some((at, item)) => done.push((at, work(&mut tool, item))),
                None => return done,
            }
        }
    };
    let mut done = std::thread::scope(|scope| {
        let other = scope.spawn(take);
        let mut done = take();
        done.extend(other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        done
    });
    done.sort_unstable_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, outcome)| outcome).collect()
}

/// Two threads for a diagnosis.
#[derive(Debug, Clone, Copy, Default)]
pub struct TwoThreads;

impl imu_diagnosis::Workers for TwoThreads {
    fn each(&self, count: usize, work: &(dyn Fn(usize) + Sync)) {
        side_by_side(0..count, || (), |_: &mut (), index| work(index));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_come_in_the_order_of_the_items_however_long_each_takes() {
        let slow_first = |_: &mut (), item: u64| {
            std::thread::sleep(std::time::Duration::from_millis(10 - item));
            item * item
        };
        assert_eq!(side_by_side(0..10, || (), slow_first), (0..10).map(|item| item * item).collect::<Vec<_>>());
        assert!(side_by_side(std::iter::empty::<u64>(), || (), slow_first).is_empty());
    }
}
