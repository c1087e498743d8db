//! The decoder: the same events for any split, and every byte accounted for.

use imu_core::sample::DiscardCause;
use vn100_proto::{BinaryAcceptance, BinaryHeader, Decoder, DecoderOptions, DecoderStats, Event};

/// The maximum number of bytes that the decoder may keep back: the longest frame and a run of garbage, with room for a
/// piece of input.
const PENDING_MAX: usize = 8192;

/// The input: a byte that selects the expected frames, one that determines how to split, then the stream.
pub fn any_split(input: &[u8]) {
    let [acceptance, split, stream @ ..] = input else { return };
    let binary = match acceptance % 3 {
        0 => BinaryAcceptance::Any,
        1 => BinaryHeader::new(0x0609, 0, 0, 0).map_or(BinaryAcceptance::Any, BinaryAcceptance::Only),
        _ => BinaryAcceptance::Never,
    };
    let whole = decode(binary, std::iter::once(stream));
    let length = usize::from(*split % 64) + 1;
    assert_eq!(whole, decode(binary, stream.chunks(length)), "pieces of {length} bytes");
    // Pieces of changing length, including empty ones.
    let mut rest = stream;
    let mut random = u32::from(*split) + 1;
    let pieces = std::iter::from_fn(|| {
        if rest.is_empty() {
            return None;
        }
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (piece, left) = rest.split_at((random >> 24) as usize % (rest.len() + 1));
        rest = left;
        Some(piece)
    });
    assert_eq!(whole, decode(binary, pieces), "pieces of changing length");
}

fn decode<'a>(binary: BinaryAcceptance, pieces: impl Iterator<Item = &'a [u8]>) -> (Vec<String>, DecoderStats) {
    let mut decoder = Decoder::new(DecoderOptions { binary });
    let (mut events, mut garbage, mut good) = (Vec::new(), 0, 0);
    let mut take = |event: Event<'_>| {
        match &event {
            Event::Rejected { cause: DiscardCause::GarbageBytes, bytes } => garbage += bytes.len() as u64,
            Event::Rejected { .. } => {}
            Event::Measurement(measurement) => {
                good += 1;
                let sample = measurement.to_sample(0, 0);
                assert!(sample.channels().iter().all(|channel| sample.get(channel).is_some_and(f64::is_finite)));
            }
            _ => good += 1,
        }
        events.push(format!("{event:?}"));
    };
    let mut bytes = 0;
    for piece in pieces {
        bytes += piece.len() as u64;
        decoder.push(piece, &mut take);
        let stats = decoder.stats();
        assert_eq!(stats.bytes_in, bytes);
        assert_eq!(stats.bytes_in, stats.frame_bytes + stats.garbage_bytes + decoder.pending() as u64);
        assert!(decoder.pending() <= PENDING_MAX, "{} bytes pending", decoder.pending());
    }
    decoder.flush(&mut take);
    let stats = decoder.stats();
    assert_eq!(decoder.pending(), 0);
    assert_eq!(stats.bytes_in, stats.frame_bytes + stats.garbage_bytes);
    assert_eq!((stats.garbage_bytes, stats.frames + stats.lines), (garbage, good), "events and counts");
    (events, stats)
}
