//! Parting: which returns of one cluster belong to which of two bodies, one of which moves.
//!
//! Segmentation joins bodies that are near each other. Where a moving body comes close to another one, both are known
//! already, so each return goes to the body whose expected box is nearest. As one body they would show neither the velocity
//! of the one nor the place of the other.
//!
//! Where it fails: bodies that are first seen together are one, until they have parted.

use vehicle::geometry::Rectangle;

use crate::segment::{Cluster, End, HIDING_M, Segments};

/// Returns farther than this from each box part no cluster: they may be of anything [m].
const CLAIM_M: f64 = 0.1;
/// So many returns show a body.
const ENOUGH: usize = 3;

/// A known body: its expected box, and whether it moves.
pub(crate) type Known = (Rectangle, bool);

impl Segments {
    /// Parts the clusters in which a body that moves touches another of the `known` ones.
    pub(crate) fn part(&mut self, known: &[Known]) {
        if !known.iter().any(|(_, moves)| *moves) {
            return;
        }
        let Self { members, clusters, parts, owners, .. } = self;
        parts.clear();
        for cluster in clusters.iter() {
            let members = &members[cluster.first..cluster.end];
            owners.clear();
            owners.extend(
                members.iter().map(|member| nearest(known, |body| body.distance_to_point(member.at))),
            );
            let claims =
                |index: usize| owners.iter().filter(|owner| **owner == Some(index)).count() >= ENOUGH;
            let claimed = |index: &usize| claims(*index);
            let bodies = (0..known.len()).filter(claimed).count();
            let moves = (0..known.len()).filter(claimed).any(|index| known[index].1);
            if bodies < 2 || !moves {
                parts.push(*cluster);
                continue;
            }
            let mut first = 0;
            let mut owner = owners.iter().flatten().copied().find(claimed);
            let mut cuts = 0;
            for index in 0..members.len() {
                let next = owners[index].filter(claimed).or(owner);
                // A single return beside those of another body shows nothing.
                let lasts = owners.get(index + 1).is_some_and(|after| after.filter(claimed).or(next) == next);
                if next != owner && lasts && index - first >= ENOUGH {
                    parts.push(Cluster {
                        first: cluster.first + first,
                        end: cluster.first + index,
                        ..*cluster
                    });
                    (first, owner) = (index, next);
                    cuts += 1;
                }
            }
            parts.push(Cluster { first: cluster.first + first, ..*cluster });
            // What is next to a cut: a body behind another one may continue there.
            let from = parts.len() - 1 - cuts;
            for cut in from..parts.len() - 1 {
                let at = parts[cut].end - cluster.first;
                let (right, left) = (members[at - 1].range, members[at].range);
                let end = |own: f64, other: f64| if other > own + HIDING_M { End::Seen } else { End::Hidden };
                parts[cut].ends[1] = end(right, left);
                parts[cut + 1].ends[0] = end(left, right);
            }
        }
        std::mem::swap(clusters, parts);
    }
}

/// Index of the nearest body, if one is near.
fn nearest(known: &[Known], distance: impl Fn(&Rectangle) -> f64) -> Option<usize> {
    let mut best = (CLAIM_M, None);
    for (index, (body, _)) in known.iter().enumerate() {
        let distance = distance(body);
        if distance < best.0 {
            best = (distance, Some(index));
        }
    }
    best.1
}
