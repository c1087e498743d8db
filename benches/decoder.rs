//! Decoder throughput: lines and binary frames as a sensor sends them, in pieces of 4 kB, as a read of a serial port
//! returns them. Goal: 200 MB/s of lines, 400 MB/s of binary frames.

use divan::counter::BytesCount;
use divan::{Bencher, black_box};
use vn100_proto::{
    AsciiType, BinaryAcceptance, BinaryHeader, ChecksumKind, Decoder, DecoderOptions, Event, Measurement,
    MeasurementKind, Quantity, checksum, encode,
};

const STREAM_BYTES: usize = 4 << 20;
const READ_BYTES: usize = 4096;

fn main() {
    divan::main();
}

fn header(text: &str) -> BinaryHeader {
    match BinaryHeader::parse_register(text) {
        Ok(header) => header,
        Err(error) => panic!("{error}"),
    }
}

/// Returns a stream of one message with changing values.
fn stream(kind: MeasurementKind) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut tick = 0_u32;
    while bytes.len() < STREAM_BYTES {
        let mut measurement = Measurement::new(kind);
        measurement.device_time_ns = Some(u64::from(tick) * 25_000_000);
        for (index, quantity) in Quantity::ALL.into_iter().enumerate() {
            let value = f64::from(tick * 31 + index as u32 * 7) * 1.234_567e-3 % 99.0 - 49.0;
            measurement.set(quantity, &[value; 9]);
        }
        encode::measurement(&mut bytes, &measurement, ChecksumKind::Xor8);
        tick += 1;
    }
    bytes
}

fn decode(bencher: Bencher, bytes: &[u8], binary: BinaryAcceptance) {
    bencher.counter(BytesCount::new(bytes.len())).bench_local(|| {
        let mut decoder = Decoder::new(DecoderOptions { binary });
        let mut sum = 0.0;
        for read in bytes.chunks(READ_BYTES) {
            decoder.push(black_box(read), &mut |event| {
                if let Event::Measurement(measurement) = event {
                    sum += measurement.scalar(Quantity::Temperature).unwrap_or(1.0);
                }
            });
        }
        (sum, decoder.stats())
    });
}

#[divan::bench(args = [AsciiType::Ymr, AsciiType::Imu, AsciiType::Ypr])]
fn ascii(bencher: Bencher, ascii: AsciiType) {
    decode(bencher, &stream(MeasurementKind::Ascii(ascii)), BinaryAcceptance::Any);
}

#[divan::bench(args = ["01,0609", "01,0739", "05,0009,000E"])]
fn binary(bencher: Bencher, fields: &str) {
    let header = header(fields);
    decode(bencher, &stream(MeasurementKind::Binary(header)), BinaryAcceptance::Only(header));
}

/// Bytes that form no frame: a wrong baud rate must not load the machine.
#[divan::bench]
fn garbage(bencher: Bencher) {
    let mut state = 1_u64;
    let bytes: Vec<u8> = (0..STREAM_BYTES)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        })
        .collect();
    decode(bencher, &bytes, BinaryAcceptance::Any);
}

#[divan::bench]
fn crc16(bencher: Bencher) {
    let bytes = stream(MeasurementKind::Ascii(AsciiType::Ymr));
    bencher.counter(BytesCount::new(bytes.len())).bench_local(|| checksum::crc16(black_box(&bytes)));
}

/// Measures the emulator's side.
#[divan::bench(args = [true, false])]
fn encode_frames(bencher: Bencher, ascii: bool) {
    let kind = if ascii { MeasurementKind::Ascii(AsciiType::Ymr) } else { MeasurementKind::Binary(header("01,0609")) };
    let mut measurement = Measurement::new(kind);
    for quantity in Quantity::ALL {
        measurement.set(quantity, &[-1.234_567; 9]);
    }
    let mut out = Vec::new();
    bencher.bench_local(|| {
        out.clear();
        encode::measurement(&mut out, black_box(&measurement), ChecksumKind::Xor8);
        out.len()
    });
}
