//! An organ in parts that are worked on at the same time: items (elements, or nodes) that lie together, some hundred a part, and colours of parts such
//! that two parts of one colour have no neighbours in each other. Parts of a colour may be done in any order, or at once, with the same bits.
//!
//! Parts come from the mesh's connections alone, so that they are the same wherever the organ is and whatever its shape: slabs of whole rings around its
//! end, for then a slab has neighbours in the one before and in the one behind, and two colours do. A slab that is too large is cut across the same way. After a
//! topology change only the parts that it touches are looked at.

/// The part of an item that is in none, and the colour of a part without items.
const NONE: u32 = u32::MAX;

/// Most items of a part, in multiples of what was asked for, before it is cut in two.
const MOST: usize = 2;

/// Appends the items that must not be worked on at the same time as one, itself among them or not, as often as it finds them.
pub(crate) trait Around: Fn(u32, &mut Vec<u32>) {}

impl<F: Fn(u32, &mut Vec<u32>)> Around for F {}

/// Items by part, and parts by colour.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parts {
    /// Part of each item.
    of: Vec<u32>,
    /// Items of each part, ascending.
    items: Vec<Vec<u32>>,
    /// Colour of each part.
    colour: Vec<u32>,
    colours: Vec<Vec<u32>>,
    /// Items of a part that are about right.
    target: usize,
}

impl Parts {
    /// Parts of about `target` items each.
    pub(crate) fn new(all: &[u32], target: usize, around: &impl Around) -> Self {
        let slots = all.last().map_or(0, |i| *i as usize + 1);
        let mut parts = Self { of: vec![NONE; slots], target, ..Self::default() };
        let mut rings = Rings { seen: vec![0; slots], stamp: 0, member: vec![false; slots] };
        let mut groups = Vec::new();
        rings.divide(all.to_vec(), target, 2, around, &mut groups);
        for group in groups {
            parts.found(group);
        }
        for part in 0..parts.items.len() {
            parts.give_colour(part, around);
        }
        parts
    }

    /// The items of a part, ascending.
    pub(crate) fn items(&self, part: usize) -> &[u32] {
        &self.items[part]
    }

    /// The part of an item.
    pub(crate) fn of(&self, item: u32) -> Option<usize> {
        self.of.get(item as usize).filter(|p| **p != NONE).map(|p| *p as usize)
    }

    /// Number of parts, empty ones among them.
    pub(crate) fn len(&self) -> usize {
        self.items.len()
    }

    /// The parts of each colour.
    pub(crate) fn colours(&self) -> &[Vec<u32>] {
        &self.colours
    }

    /// Carries it over a change: items that went and items that came, and items (ascending) that are still there but with other neighbours. Gives the parts
    /// that changed, ascending.
    pub(crate) fn adopt(&mut self, gone: &[u32], come: &[u32], changed: &[u32], around: &impl Around) -> Vec<usize> {
        let mut touched: Vec<usize> = changed.iter().filter_map(|i| self.of(*i)).collect();
        for item in gone {
            if let Some(part) = self.of(*item) {
                self.of[*item as usize] = NONE;
                self.items[part].retain(|i| i != item);
                touched.push(part);
            }
        }
        let mut near = Vec::new();
        for item in come {
            if self.of.len() <= *item as usize {
                self.of.resize(*item as usize + 1, NONE);
            }
            near.clear();
            around(*item, &mut near);
            let mut found: Vec<usize> = near.iter().filter_map(|i| self.of(*i)).collect();
            found.sort_unstable();
            // The part that most of its neighbours are in, of several the first.
            let best = found.chunk_by(|a, b| a == b).max_by_key(|c| (c.len(), std::cmp::Reverse(c[0]))).map(|c| c[0]);
            let part = best.unwrap_or_else(|| self.found(Vec::new()));
            self.of[*item as usize] = part as u32;
            let at = self.items[part].partition_point(|i| i < item);
            self.items[part].insert(at, *item);
            touched.push(part);
        }
        touched.sort_unstable();
        touched.dedup();
        for part in touched.clone() {
            if self.items[part].len() > MOST * self.target {
                touched.extend(self.cut(part, self.target, around));
            }
        }
        for part in &touched {
            self.lose_colour(*part);
        }
        for part in &touched {
            self.give_colour(*part, around);
        }
        touched
    }

    /// Cuts a part into smaller ones that still need a colour; gives those that are new.
    pub(crate) fn cut(&mut self, part: usize, target: usize, around: &impl Around) -> Vec<usize> {
        let items = std::mem::take(&mut self.items[part]);
        let mut rings = Rings { seen: vec![0; self.of.len()], stamp: 0, member: vec![false; self.of.len()] };
        let mut groups = Vec::new();
        rings.divide(items, target, 2, around, &mut groups);
        let mut groups = groups.into_iter();
        self.items[part] = groups.next().unwrap_or_default();
        groups.map(|group| self.found(group)).collect()
    }

    /// A new part, without a colour.
    fn found(&mut self, items: Vec<u32>) -> usize {
        let part = self.items.len();
        for item in &items {
            self.of[*item as usize] = part as u32;
        }
        self.items.push(items);
        self.colour.push(NONE);
        part
    }

    /// Gives a part that was cut, or that has new neighbours, a colour that is right for it.
    pub(crate) fn recolour(&mut self, part: usize, around: &impl Around) {
        self.lose_colour(part);
        self.give_colour(part, around);
    }

    fn lose_colour(&mut self, part: usize) {
        let colour = std::mem::replace(&mut self.colour[part], NONE);
        if colour != NONE {
            self.colours[colour as usize].retain(|p| *p as usize != part);
        }
    }

    /// The first colour that no part beside it has; none without items.
    fn give_colour(&mut self, part: usize, around: &impl Around) {
        if self.items[part].is_empty() {
            return;
        }
        let mut used = vec![false; self.colours.len() + 1];
        let mut near = Vec::new();
        for item in &self.items[part] {
            near.clear();
            around(*item, &mut near);
            for other in near.iter().filter_map(|i| self.of(*i)) {
                if self.colour[other] != NONE {
                    used[self.colour[other] as usize] = true;
                }
            }
        }
        let colour = used.iter().position(|u| !u).unwrap_or(self.colours.len());
        if colour == self.colours.len() {
            self.colours.push(Vec::new());
        }
        self.colour[part] = colour as u32;
        let at = self.colours[colour].partition_point(|p| (*p as usize) < part);
        self.colours[colour].insert(at, part as u32);
    }
}

/// Rings of neighbours around an end of a set of items.
struct Rings {
    /// The walk in which an item was seen last.
    seen: Vec<u32>,
    stamp: u32,
    member: Vec<bool>,
}

impl Rings {
    /// Divides items into groups of whole rings of about `target` items, and what is much more than that once more across.
    fn divide(&mut self, items: Vec<u32>, target: usize, depth: u32, around: &impl Around, groups: &mut Vec<Vec<u32>>) {
        if items.len() <= target + target / 4 {
            groups.extend(Some(items).filter(|g| !g.is_empty()));
            return;
        }
        let rings = self.around_an_end(&items, around);
        // Slabs of two rings share half of their nodes with those beside them; thinner ones share more.
        let thickness = if depth > 0 { 2 } else { 1 };
        let wanted = items.len().div_ceil(target).min(rings.len().div_ceil(thickness)).max(1);
        let (mut group, mut before, mut founded) = (Vec::new(), 0, 0);
        for ring in rings {
            // A ring goes to the slab that has its middle.
            let middle = before + ring.len() / 2;
            let slab = (middle * wanted / items.len()).min(wanted - 1);
            if slab > founded && !group.is_empty() {
                self.finish(std::mem::take(&mut group), target, depth, around, groups);
                founded = slab;
            }
            before += ring.len();
            group.extend(ring);
        }
        self.finish(group, target, depth, around, groups);
    }

    fn finish(&mut self, mut group: Vec<u32>, target: usize, depth: u32, around: &impl Around, groups: &mut Vec<Vec<u32>>) {
        group.sort_unstable();
        if depth > 0 && group.len() > target + target / 4 {
            self.divide(group, target, depth - 1, around, groups);
        } else if !group.is_empty() {
            groups.push(group);
        }
    }

    /// The items in rings around an end of theirs, one connected piece after the other.
    fn around_an_end(&mut self, items: &[u32], around: &impl Around) -> Vec<Vec<u32>> {
        items.iter().for_each(|i| self.member[*i as usize] = true);
        let mut all: Vec<Vec<u32>> = Vec::new();
        for item in items {
            if self.member[*item as usize] {
                // From anywhere to the far end, from there to the other one; the rings are counted from that.
                let mut start = vec![*item];
                for _ in 0..2 {
                    start = self.walk(&start, around).pop().unwrap_or_default();
                }
                let rings = self.walk(&start, around);
                rings.iter().flatten().for_each(|i| self.member[*i as usize] = false);
                all.extend(rings);
            }
        }
        all
    }

    fn walk(&mut self, start: &[u32], around: &impl Around) -> Vec<Vec<u32>> {
        self.stamp += 1;
        start.iter().for_each(|i| self.seen[*i as usize] = self.stamp);
        let mut rings = vec![start.to_vec()];
        let mut near = Vec::new();
        while let Some(last) = rings.last() {
            let mut ring = Vec::new();
            for item in last {
                near.clear();
                around(*item, &mut near);
                for other in &near {
                    let at = *other as usize;
                    if self.member.get(at) == Some(&true) && self.seen[at] != self.stamp {
                        self.seen[at] = self.stamp;
                        ring.push(*other);
                    }
                }
            }
            if ring.is_empty() {
                break;
            }
            ring.sort_unstable();
            rings.push(ring);
        }
        rings
    }
}
