//! Noise with a law that is not in the library.

use super::{Drawn, events};
use crate::draw::Draw;
use crate::kind::Kind;

pub(super) fn draw(kind: Kind, device: &mut Draw) -> Option<Drawn> {
    Some(match kind {
        // Two humps: every sample lies on one side of the middle or the other. The variance is kept.
        Kind::BimodalNoise => {
            let size = device.uniform(0.5, 0.9);
            Drawn::new(size, "apart", move |column, _, draw| {
                let (signs, rest) = (draw.split(), (1.0 - size * size).sqrt());
                let mut signs = signs;
                column
                    .amplify(|_, white| if white == 0.0 { 1.0 } else { (rest * white + size * signs.sign()) / white });
            })
        }
        // Evenly spread in part. The variance is kept.
        Kind::UniformNoise => {
            let size = device.uniform(0.6, 1.0);
            Drawn::new(size, "part", move |column, _, draw| {
                let rest = (1.0 - size * size).sqrt();
                let half = size * 3.0_f64.sqrt();
                column.amplify(
                    |_, white| if white == 0.0 { 1.0 } else { (rest * white + draw.uniform(-half, half)) / white },
                );
            })
        }
        // GARCH(1,1): loud samples follow loud ones.
        Kind::VolatileNoise => {
            let size = device.uniform(0.08, 0.25);
            Drawn::new(size, "alpha", move |column, _, _| {
                let (beta, mut variance) = (0.97 - size, 1.0);
                column.amplify(|_, white| {
                    let gain = f64::sqrt(variance);
                    variance = (1.0 - size - beta) + (size * white * white + beta) * variance;
                    gain
                });
            })
        }
        // Values above the middle are louder than those below.
        Kind::AsymmetricGain => {
            let size = device.log_uniform(0.08, 0.4);
            Drawn::new(size, "gain", move |column, _, _| {
                column.amplify(|_, white| if white > 0.0 { 1.0 + size } else { 1.0 - size });
            })
        }
        // Spikes that come in clusters.
        Kind::ClusteredSpikes => {
            let (size, apart) = (device.log_uniform(6.0, 40.0), device.log_uniform(2_000.0, 15_000.0));
            let (cluster, within) = (device.whole(4, 12), device.uniform(3.0, 12.0));
            Drawn::new(size, "amplitude", move |column, _, draw| {
                let (length, scale) = (column.values.len(), column.scale);
                for begin in events(length, apart, draw) {
                    let mut at = begin;
                    for _ in 0..cluster {
                        if let Some(value) = column.values.get_mut(at) {
                            *value += scale * size * draw.sign() * draw.uniform(0.6, 1.4);
                        }
                        at += draw.wait(1.0 / within).unwrap_or(length);
                    }
                }
            })
        }
        _ => return None,
    })
}
