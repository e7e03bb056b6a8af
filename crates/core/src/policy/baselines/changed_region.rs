//! The largest connected region of changed pixels between two grey pictures.
//!
//! The pictures are read once, row by row. Changed pixels of a row form runs; a run is connected to every run of the
//! row above that shares a column with it (4-connectivity). Only the runs of two rows and the sizes of their regions
//! are kept, in a disjoint-set forest over these runs: a region that does not reach the current row cannot grow any
//! more.

/// A maximal run of changed pixels in one row: columns `start..end`.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: u32,
    end: u32,
    /// Region of the run: an index into `regions` of its row.
    region: u32,
}

/// A node of the forest.
#[derive(Clone, Copy, Debug)]
struct Region {
    /// Region of the same list that this one was merged into, or itself.
    parent: u32,
    /// Pixels so far; valid for roots only.
    pixels: u64,
}

/// The search with its buffers, which are reused between calls and never outgrow a picture's row.
#[derive(Clone, Debug, Default)]
pub(super) struct ChangedRegion {
    changed: Vec<u8>,
    above: Vec<Run>,
    row: Vec<Run>,
    /// Regions of the row above, then those that begin in the current row.
    regions: Vec<Region>,
    /// New index of each region that reaches the current row.
    renumbered: Vec<u32>,
    kept: Vec<Region>,
}

const NONE: u32 = u32::MAX;

impl ChangedRegion {
    /// True if more than `size` connected pixels differ by `difference` or more between `before` and `after`, two
    /// pictures of the same size with `width` pixels per row.
    pub(crate) fn exceeds(
        &mut self,
        width: usize,
        before: &[u8],
        after: &[u8],
        difference: u8,
        size: u64,
    ) -> bool {
        self.above.clear();
        self.regions.clear();
        self.changed.resize(width, 0);
        // A width of 0 means no pixels, but chunks of 0 would panic.
        let rows = before.chunks_exact(width.max(1)).zip(after.chunks_exact(width.max(1)));
        for (before, after) in rows {
            self.find_runs(before, after, difference);
            if self.row.is_empty() {
                self.above.clear();
                self.regions.clear();
                continue;
            }
            if self.join() > size {
                return true;
            }
            self.keep_row();
        }
        false
    }

    fn find_runs(&mut self, before: &[u8], after: &[u8], difference: u8) {
        self.row.clear();
        let mut any = 0;
        for ((changed, &before), &after) in self.changed.iter_mut().zip(before).zip(after) {
            *changed = u8::from(before.abs_diff(after) >= difference);
            any |= *changed;
        }
        if any == 0 {
            return;
        }
        // Runs lie between the transitions from unchanged to changed and back.
        let mut rest = 0;
        let until = |from: usize, wanted: u8| {
            let tail = &self.changed[from..];
            tail.iter().position(|&changed| changed == wanted)
        };
        while let Some(skipped) = until(rest, 1) {
            let start = rest + skipped;
            let end = until(start, 0).map_or(self.changed.len(), |length| start + length);
            self.row.push(Run {
                start: start as u32,
                end: end as u32,
                region: NONE,
            });
            rest = end;
        }
    }

    /// Assigns a region to every run of the row; returns the size of the largest one.
    fn join(&mut self) -> u64 {
        let mut first = 0;
        let mut largest = 0;
        for run in &mut self.row {
            while self.above.get(first).is_some_and(|above| above.end <= run.start) {
                first += 1;
            }
            for above in &self.above[first..] {
                if above.start >= run.end {
                    break;
                }
                let region = root(&mut self.regions, above.region);
                if run.region == NONE {
                    run.region = region;
                } else if run.region != region {
                    let absorbed = self.regions[region as usize].pixels;
                    self.regions[region as usize].parent = run.region;
                    self.regions[run.region as usize].pixels += absorbed;
                }
            }
            let pixels = u64::from(run.end - run.start);
            if run.region == NONE {
                run.region = self.regions.len() as u32;
                self.regions.push(Region {
                    parent: run.region,
                    pixels,
                });
            } else {
                self.regions[run.region as usize].pixels += pixels;
            }
            largest = largest.max(self.regions[run.region as usize].pixels);
        }
        largest
    }

    /// Makes the current row the row above, and keeps only the regions that reach it.
    fn keep_row(&mut self) {
        self.renumbered.clear();
        self.renumbered.resize(self.regions.len(), NONE);
        self.kept.clear();
        for run in &mut self.row {
            let region = root(&mut self.regions, run.region);
            let number = &mut self.renumbered[region as usize];
            if *number == NONE {
                *number = self.kept.len() as u32;
                self.kept.push(Region {
                    parent: *number,
                    pixels: self.regions[region as usize].pixels,
                });
            }
            run.region = *number;
        }
        std::mem::swap(&mut self.regions, &mut self.kept);
        std::mem::swap(&mut self.above, &mut self.row);
    }
}

/// Returns the root of `region`'s tree, and halves the path to it.
fn root(regions: &mut [Region], mut region: u32) -> u32 {
    loop {
        let parent = regions[region as usize].parent;
        if parent == region {
            return region;
        }
        let grandparent = regions[parent as usize].parent;
        regions[region as usize].parent = grandparent;
        region = grandparent;
    }
}

#[cfg(test)]
mod tests;
