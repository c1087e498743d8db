//! The published vectors, recordings if they are available, and properties of decoder and encoder together.

use super::ascii::{Trailer, split_line};
use super::binary::KNOWN_BITS;
use super::checksum::{crc16, xor8};
use super::*;
use imu_core::sample::DiscardCause;
use proptest::prelude::*;
use serde_json::Value;

/// The length of the longest binary frame: every group with every field.
const FRAME_BYTES_MAX: usize = 433;
const ASCII_VECTORS: &str = include_str!("../../../tests/golden/protocol/ascii.json");
const BINARY_VECTORS: &str = include_str!("../../../tests/golden/protocol/binary.json");

/// An event that owns its content.
#[derive(Debug, Clone, PartialEq)]
enum Owned {
    Measurement(Box<Measurement>),
    Reply(String),
    DeviceError(DeviceError),
    Other(String),
    Rejected(DiscardCause, Vec<u8>),
}

fn owned(event: Event<'_>) -> Owned {
    match event {
        Event::Measurement(measurement) => Owned::Measurement(Box::new(measurement.clone())),
        Event::Reply(reply) => Owned::Reply(reply.body.to_owned()),
        Event::DeviceError(error) => Owned::DeviceError(error),
        Event::Other(body) => Owned::Other(body.to_owned()),
        Event::Rejected { cause, bytes } => Owned::Rejected(cause, bytes.to_vec()),
    }
}

/// Returns all events of the bytes, pushed in pieces, flushed at the end.
fn decode_pieces<'a>(
    pieces: impl IntoIterator<Item = &'a [u8]>,
    options: DecoderOptions,
) -> (Vec<Owned>, DecoderStats) {
    let mut decoder = Decoder::new(options);
    let mut events = Vec::new();
    for piece in pieces {
        decoder.push(piece, &mut |event| events.push(owned(event)));
        let stats = decoder.stats();
        assert_eq!(stats.bytes_in, stats.frame_bytes + stats.garbage_bytes + decoder.pending() as u64);
        // a run of garbage, the longest candidate, nothing more
        assert!(decoder.pending() < decoder::GARBAGE_RUN_BYTES + FRAME_BYTES_MAX.max(ascii::MAX_LINE_BYTES));
    }
    decoder.flush(&mut |event| events.push(owned(event)));
    assert_eq!(decoder.pending(), 0);
    let stats = decoder.stats();
    assert_eq!(stats.bytes_in, stats.frame_bytes + stats.garbage_bytes);
    let garbage: usize = events
        .iter()
        .map(|event| match event {
            Owned::Rejected(DiscardCause::GarbageBytes, bytes) => bytes.len(),
            _ => 0,
        })
        .sum();
    assert_eq!(stats.garbage_bytes, garbage as u64);
    (events, stats)
}

fn decode(bytes: &[u8]) -> (Vec<Owned>, DecoderStats) {
    decode_pieces([bytes], DecoderOptions::default())
}

fn measurements(events: &[Owned]) -> Vec<&Measurement> {
    events
        .iter()
        .filter_map(|event| match event {
            Owned::Measurement(measurement) => Some(&**measurement),
            _ => None,
        })
        .collect()
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_else(|| panic!("no {key} in {value}"))
}

/// Returns the names of the ASCII vectors' expectations.
fn expected_value(measurement: &Measurement, name: &str) -> Option<f64> {
    use Quantity::{
        Accel, AngularRate, LinearAccelBody, LinearAccelNed, Mag, Pressure, Quaternion, Temperature, UncompAccel,
        UncompGyro, UncompMag, YawPitchRoll,
    };
    let (quantity, index) = match name {
        "yaw" => (YawPitchRoll, 0),
        "pitch" => (YawPitchRoll, 1),
        "roll" => (YawPitchRoll, 2),
        "q0" => (Quaternion, 0),
        "q1" => (Quaternion, 1),
        "q2" => (Quaternion, 2),
        "q3" => (Quaternion, 3),
        "temp_c" => (Temperature, 0),
        "pres_kpa" => (Pressure, 0),
        other => {
            let (stem, axis) = other.split_at(other.len() - 1);
            let quantity = match stem {
                "m" => Mag,
                "a" => Accel,
                "g" => AngularRate,
                "um" => UncompMag,
                "ua" => UncompAccel,
                "ug" => UncompGyro,
                "ab" => LinearAccelBody,
                "an" => LinearAccelNed,
                _ => panic!("unknown name {other}"),
            };
            (quantity, "xyz".find(axis).unwrap())
        }
    };
    measurement.get(quantity).map(|values| values[index])
}

/// Returns whether every number has the widths and decimals of firmware 2 and 3, and a serial count its ten digits.
fn has_firmware_3_format(ascii: AsciiType, fields: &str) -> bool {
    let mut fields = fields.split(',');
    let numbers = ascii.quantities().iter().all(|quantity| {
        let format = quantity.ascii_format();
        fields.by_ref().take(quantity.components()).all(|field| {
            let decimals = field.split_once('.').map_or(0, |(_, decimals)| decimals.len());
            let natural = field.trim_start_matches(['+', '-']).trim_start_matches('0').len() + 2;
            field.starts_with(['+', '-'])
                && decimals == format.decimals
                && (field.len() == format.width || (field.len() > format.width && natural > format.width))
        })
    });
    numbers && fields.all(|field| !field.starts_with('T') || field.len() == 11)
}

#[test]
fn every_ascii_vector_is_what_its_source_states() {
    let vectors = json(ASCII_VECTORS);
    let vectors = vectors["vectors"].as_array().unwrap();
    assert_eq!(vectors.len(), 117);
    let (mut compared, mut written_again, mut appended) = (0, 0, 0);
    for vector in vectors {
        let line = text(vector, "line");
        let bytes = format!("{line}\r\n").into_bytes();
        if let Some(length) = vector["bytes_with_crlf"].as_u64() {
            assert_eq!(bytes.len() as u64, length, "{line}");
        }
        let body = line.trim_start_matches('$').rsplit_once('*').map_or(line, |(body, _)| body);
        if let Some(expected) = vector["xor8"].as_str() {
            assert_eq!(format!("{:02X}", xor8(body.as_bytes())), expected, "{line}");
        }
        if let Some(expected) = vector["crc16"].as_str() {
            assert_eq!(format!("{:04X}", crc16(body.as_bytes())), expected, "{line}");
        }
        let (events, stats) = decode(&bytes);
        let kind = match text(vector, "status") {
            "ok8" => ChecksumKind::Xor8,
            "ok16" => ChecksumKind::Crc16,
            status => {
                assert_eq!((stats.lines, stats.malformed), (0, 0), "{line}");
                assert_eq!(stats.garbage_bytes, bytes.len() as u64, "{line}");
                let damaged = u64::from(!line.starts_with("$VNYMRX"));
                assert_eq!(stats.bad_checksums, damaged, "{line}");
                let trailer = split_line(line.as_bytes()).map(|(_, trailer)| trailer);
                match status {
                    "bypass" => assert_eq!(trailer, Some(Trailer::Bypass(ChecksumKind::Xor8)), "{line}"),
                    "malformed" => assert_eq!(trailer, None, "{line}"),
                    "bad8" => assert!(matches!(trailer, Some(Trailer::Xor8(_))), "{line}"),
                    other => panic!("unknown status {other}"),
                }
                continue;
            }
        };
        let mut again = Vec::new();
        encode::text_line(&mut again, body, kind);
        assert_eq!(String::from_utf8_lossy(&again), String::from_utf8_lossy(&bytes));
        if vector.get("expect_error").is_some() {
            assert_eq!((stats.lines, stats.malformed, stats.bad_checksums), (0, 1, 0), "{line}");
            assert_eq!(events.first(), Some(&Owned::Rejected(DiscardCause::Malformed, bytes)), "{line}");
            continue;
        }
        assert_eq!((stats.lines, stats.garbage_bytes, events.len()), (1, 0, 1), "{line}");
        let measurement = match &events[0] {
            Owned::Measurement(measurement) => Some((**measurement).clone()),
            Owned::Reply(reply) => {
                assert_eq!(reply, body);
                let reply = Reply::parse(reply).unwrap();
                assert!(reply.register.is_some() == (body.starts_with("VNRRG") || body.starts_with("VNWRG")), "{line}");
                reply.measurement()
            }
            Owned::DeviceError(error) => {
                let expected = match line {
                    "$VNERR,03*72" => DeviceError::InvalidChecksum,
                    "$VNERR,12*72" => DeviceError::InsufficientBaudRate,
                    other => panic!("an error of no vector: {other}"),
                };
                assert_eq!(*error, expected);
                None
            }
            other => panic!("{line}: {other:?}"),
        };
        if let Some(expected) = vector.get("expect").and_then(Value::as_object) {
            let measurement = measurement.as_ref().unwrap_or_else(|| panic!("{line} is no measurement"));
            for (name, value) in expected {
                let value = value.as_f64().unwrap();
                assert_eq!(
                    expected_value(measurement, name).map(f64::to_bits),
                    Some(value.to_bits()),
                    "{line}: {name}"
                );
                compared += 1;
            }
        }
        if let Some(count) = vector.get("append_count").and_then(Value::as_u64) {
            assert_eq!(measurement.as_ref().unwrap().sync_count.map(u64::from), Some(count), "{line}");
            appended += 1;
        }
        if let Some(status) = vector.get("append_status_hex").and_then(Value::as_str) {
            let status = u16::from_str_radix(status, 16).unwrap();
            assert_eq!(measurement.as_ref().unwrap().vpe_status, Some(status), "{line}");
            appended += 1;
        }
        // the encoder prints what the device prints: messages, and the values of measurement registers
        if let Some(measurement) = measurement {
            let MeasurementKind::Ascii(ascii) = measurement.kind else { panic!("{line}") };
            let head = if body.starts_with("VNRRG") { 2 } else { 1 };
            let fields = body.splitn(head + 1, ',').last().unwrap();
            if has_firmware_3_format(ascii, fields) {
                let mut again = Vec::new();
                if head == 1 {
                    encode::measurement(&mut again, &measurement, kind);
                    assert_eq!(String::from_utf8_lossy(&again), format!("{line}\r\n"));
                } else {
                    encode::numbers(&mut again, ascii, &measurement);
                    assert_eq!(String::from_utf8_lossy(&again), format!(",{fields}"), "{line}");
                }
                written_again += 1;
            }
        }
    }
    assert!(compared >= 250, "{compared} values compared");
    assert!(written_again >= 24, "{written_again} messages written again");
    assert_eq!(appended, 5);
}

#[test]
fn the_registers_of_the_vectors_are_read_and_printed_again() {
    let vectors = json(ASCII_VECTORS);
    let mut printed = 0;
    for vector in vectors["vectors"].as_array().unwrap() {
        let Some((body, Trailer::Xor8(_) | Trailer::Crc16(_))) = split_line(text(vector, "line").as_bytes()) else {
            continue;
        };
        let body = std::str::from_utf8(body).unwrap();
        let Some(Reply { register: Some(number), values, .. }) = Reply::parse(body) else { continue };
        if values.is_empty() {
            continue;
        }
        let again = match number {
            30 => register::CommunicationControl::parse(values).unwrap().to_string(),
            32 => register::SyncControl::parse(values).unwrap().to_string(),
            33 => register::SyncStatus::parse(values).unwrap().to_string(),
            75..=77 => match register::BinaryOutput::parse(number, values) {
                Ok(output) => output.to_string(),
                Err(error) => {
                    // GNSS groups and fields, a velocity field: other products
                    assert!(["34", "4E", "073E"].iter().any(|foreign| values.contains(foreign)), "{error}");
                    continue;
                }
            },
            85 => register::ImuFilter::parse(values).unwrap().to_string(),
            _ => continue,
        };
        assert_eq!(again, values, "{body}");
        printed += 1;
    }
    assert!(printed >= 7, "{printed} registers printed");
}

fn bytes_of_hex(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|index| u8::from_str_radix(&hex[2 * index..2 * index + 2], 16).unwrap()).collect()
}

/// Compares a binary measurement with an expectation of the vectors; counts the values.
fn compare_binary(measurement: &Measurement, expected: &serde_json::Map<String, Value>) -> usize {
    use Quantity::{Accel, AngularRate, Mag, Pressure, Quaternion, Temperature, UncompAccel, UncompGyro, YawPitchRoll};
    let mut compared = 0;
    for (name, value) in expected {
        let quantities: &[Quantity] = match name.as_str() {
            "Common.TimeStartup" => {
                assert_eq!(measurement.device_time_ns, value.as_u64());
                compared += 1;
                continue;
            }
            "Common.YawPitchRoll" => &[YawPitchRoll],
            "Common.Quaternion" => &[Quaternion],
            "Common.AngularRate" => &[AngularRate],
            "Common.Accel" => &[Accel],
            "Common.Imu(UncompAccel,UncompGyro)" => &[UncompAccel, UncompGyro],
            "Common.MagPres(Mag,Temp,Pres)" => &[Mag, Temperature, Pressure],
            "Imu.Temp" => &[Temperature],
            other => panic!("unknown field {other}"),
        };
        let found: Vec<f64> =
            quantities.iter().flat_map(|quantity| measurement.get(*quantity).unwrap_or_default().to_vec()).collect();
        let expected: Vec<f64> = match value {
            Value::Array(values) => values.iter().map(|value| value.as_f64().unwrap()).collect(),
            single => vec![single.as_f64().unwrap()],
        };
        // serde_json reads decimals to within an ulp of a double; the field is a 32-bit float, which that determines
        let narrow = |values: &[f64]| values.iter().map(|value| *value as f32).collect::<Vec<_>>();
        assert_eq!(narrow(&found), narrow(&expected), "{name}");
        assert!(found.iter().all(|value| f64::from(*value as f32).to_bits() == value.to_bits()), "{name}");
        compared += found.len();
    }
    compared
}

#[test]
fn every_binary_vector_is_what_its_source_states() {
    let vectors = json(BINARY_VECTORS);
    let good = vectors["good"].as_array().unwrap();
    assert_eq!(good.len(), 4);
    let mut compared = 0;
    for vector in good {
        let bytes = bytes_of_hex(text(vector, "hex"));
        assert_eq!(Some(bytes.len() as u64), vector["len"].as_u64());
        let crc = crc16(&bytes[1..bytes.len() - 2]);
        assert_eq!(format!("{crc:04X}"), text(vector, "crc_be"));
        let (events, stats) = decode(&bytes);
        assert_eq!((stats.frames, stats.garbage_bytes, events.len()), (1, 0, 1));
        let found = measurements(&events);
        compared += compare_binary(found[0], vector["expect"].as_object().unwrap());
        let mut again = Vec::new();
        encode::measurement(&mut again, found[0], ChecksumKind::Xor8);
        assert_eq!(again, bytes, "{}", text(vector, "source"));
    }
    assert_eq!(compared, 3 + 4 + 4 + 14);
    for vector in vectors["bad"].as_array().unwrap() {
        let bytes = bytes_of_hex(text(vector, "hex"));
        let why = text(vector, "why");
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&bytes, &mut |event| assert!(matches!(event, Event::Rejected { .. }), "{why}"));
        let incomplete = why.contains("incomplete");
        assert_eq!(decoder.stats().bad_checksums, u64::from(!incomplete), "{why}");
        assert_eq!(
            decoder.pending() == bytes.len() && decoder.stats().garbage_bytes == 0,
            incomplete || bytes.len() < 256
        );
        decoder.flush(&mut |event| assert!(matches!(event, Event::Rejected { .. }), "{why}"));
        assert_eq!(decoder.stats().garbage_bytes, bytes.len() as u64, "{why}");
        assert_eq!(decoder.stats().bad_checksums, u64::from(!incomplete), "{why}");
    }
    for vector in vectors["crc16"].as_array().unwrap() {
        assert_eq!(format!("{:04X}", crc16(text(vector, "ascii").as_bytes())), text(vector, "crc"));
    }
}

#[test]
fn excerpts_of_real_streams_decode_as_counted_there() {
    let Some(path) = vn100_testkit::real_data("../vectors/captures.json") else { return };
    let captures = json(&std::fs::read_to_string(path).unwrap());
    for frame in captures["frames"].as_array().unwrap() {
        let bytes = bytes_of_hex(text(frame, "hex"));
        let (events, stats) = decode(&bytes);
        assert_eq!((stats.frames, stats.garbage_bytes), (1, 0));
        let found = measurements(&events);
        assert!(compare_binary(found[0], frame["expect"].as_object().unwrap()) >= 20);
        assert_eq!(found[0].device_time_ns.unwrap() % 1000, 0);
        let mut again = Vec::new();
        encode::measurement(&mut again, found[0], ChecksumKind::Xor8);
        assert_eq!(again, bytes);
    }
    for line in captures["lines"].as_array().unwrap() {
        let bytes = format!("{}\r\n", text(line, "line")).into_bytes();
        let (events, stats) = decode(&bytes);
        assert_eq!((stats.lines, stats.garbage_bytes), (1, 0));
        let found = measurements(&events);
        for (name, value) in line["expect"].as_object().unwrap() {
            assert_eq!(expected_value(found[0], name), value.as_f64(), "{name}");
        }
        let mut again = Vec::new();
        encode::measurement(&mut again, found[0], ChecksumKind::Xor8);
        assert_eq!(again, bytes);
    }
    for (name, outside) in [("mixed_stream", Some(48)), ("b6_flip", None), ("stale_divisor", None)] {
        let stream = &captures[name];
        let bytes = bytes_of_hex(text(stream, "hex"));
        let (_, stats) = decode(&bytes);
        assert_eq!(Some(stats.frames), stream["valid_frames"].as_u64(), "{name}");
        assert_eq!(Some(stats.lines), stream["valid_lines"].as_u64(), "{name}");
        println!("{name}: {stats:?}");
        if let Some(outside) = outside {
            assert_eq!(stats.garbage_bytes, outside, "{name}: {stats:?}");
        }
    }
}

#[test]
fn a_real_recording_is_decoded_and_written_again_byte_for_byte() {
    use std::io::Read;
    let Some(path) = vn100_testkit::real_data("vn100-desk/live_capture.txt.gz") else { return };
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_end(&mut bytes).unwrap();
    let crlf = bytes.windows(2).any(|pair| pair == b"\r\n");
    let (mut samples, mut again) = (0, Vec::new());
    let mut decoder = Decoder::new(DecoderOptions { binary: BinaryAcceptance::Never });
    decoder.push(&bytes, &mut |event| match event {
        Event::Measurement(measurement) => {
            samples += 1;
            encode::measurement(&mut again, measurement, ChecksumKind::Xor8);
            if !crlf {
                again.truncate(again.len() - 2);
                again.push(b'\n');
            }
        }
        other => panic!("{other:?}"),
    });
    println!("{samples} samples, {} of {} bytes pending", decoder.pending(), bytes.len());
    assert_eq!(samples, 30_178);
    assert!(again == bytes, "the lines written again differ from the recording");
}

#[test]
fn a_broken_binary_frame_does_not_swallow_the_reply_behind_it() {
    let vectors = json(BINARY_VECTORS);
    let mut bytes = bytes_of_hex(text(&vectors["good"][3], "hex"));
    // the frame loses ten bytes, so that its length reaches into the reply
    bytes.drain(20..30);
    let reply_start = bytes.len();
    encode::text_line(&mut bytes, "VNRRG,01,VN-100T-CR", ChecksumKind::Xor8);
    let (events, stats) = decode(&bytes);
    assert_eq!((stats.bad_checksums, stats.lines, stats.garbage_bytes), (1, 1, reply_start as u64));
    assert_eq!(events.last(), Some(&Owned::Reply("VNRRG,01,VN-100T-CR".to_owned())));
}

#[test]
fn a_false_header_is_decided_as_soon_as_its_length_is_there() {
    let longest = BinaryHeader::new(KNOWN_BITS[0], KNOWN_BITS[1], KNOWN_BITS[2], KNOWN_BITS[3]).unwrap();
    let mut head = vec![binary::SYNC, longest.groups()];
    longest.masks().for_each(|mask| head.extend(mask.to_le_bytes()));
    let line = b"$VNACC,+00.105,-00.250,-10.148*4F\r\n";
    let mut decoder = Decoder::new(DecoderOptions::default());
    let mut found = 0;
    decoder.push(&head, &mut |event| panic!("{event:?}"));
    let mut pushed = head.len();
    while found == 0 {
        decoder.push(line, &mut |event| found += usize::from(matches!(event, Event::Measurement(_))));
        pushed += line.len();
        assert!(pushed < longest.frame_bytes() + line.len());
    }
    // all lines inside the false frame are there at once
    assert_eq!(found, (pushed - head.len()) / line.len());
    assert_eq!(decoder.pending(), 0);
    // and if nothing more comes, a flush decides
    decoder.push(&head, &mut |_| ());
    decoder.push(line, &mut |event| panic!("{event:?}"));
    let mut events = Vec::new();
    decoder.flush(&mut |event| events.push(owned(event)));
    assert_eq!(measurements(&events).len(), 1);
    assert_eq!(decoder.stats().garbage_bytes, 2 * head.len() as u64);
}

#[test]
fn only_the_configured_header_is_accepted() {
    let vectors = json(BINARY_VECTORS);
    let bytes = bytes_of_hex(text(&vectors["good"][0], "hex"));
    let only = |text| BinaryAcceptance::Only(BinaryHeader::parse_register(text).unwrap());
    for (binary, frames) in
        [(only("01,0008"), 1), (only("01,0009"), 0), (BinaryAcceptance::Never, 0), (BinaryAcceptance::Any, 1)]
    {
        let (_, stats) = decode_pieces([&bytes[..]], DecoderOptions { binary });
        assert_eq!((stats.frames, stats.bad_checksums), (frames, 0), "{binary:?}");
    }
    // a change counts from the pending bytes on
    let mut decoder = Decoder::new(DecoderOptions { binary: BinaryAcceptance::Any });
    let mut frames = 0;
    decoder.push(&bytes[..10], &mut |event| panic!("{event:?}"));
    decoder.accept_binary(only("01,0009"));
    decoder.push(&bytes[10..], &mut |event| frames += u32::from(matches!(event, Event::Measurement(_))));
    assert_eq!((frames, decoder.pending()), (0, bytes.len()));
}

#[test]
fn each_damaged_frame_counts_once() {
    let good = b"$VNACC,+00.105,-00.250,-10.148*4F\r\n";
    for (bad, why) in [
        (&b"$VNACC,+00.105,-00.251,-10.148*4F\r\n"[..], "a digit"),
        (b"$VNACC,+00.105,-00.250,-10.148*4v\r\n", "a checksum digit"),
        (b"$VNACC,+00.105,-00.250,-10.148j4F\r\n", "the star"),
        (b"$VNACC,+00.\xB105,-00.250,-10.148*4F\r\n", "a bit 7"),
        (b"$VNACC,+00.105,-00.250,-10.1", "cut"),
        (b"$VNACC,+00.105,-00.250,-10.148*4F\r", "its line feed"),
    ] {
        let stream = [&good[..], bad, good].concat();
        let (events, stats) = decode(&stream);
        assert_eq!((stats.lines, stats.bad_checksums, stats.garbage_bytes), (2, 1, bad.len() as u64), "{why}");
        assert_eq!(measurements(&events).len(), 2, "{why}");
    }
    // without its first bytes it cannot be distinguished from garbage
    let (_, stats) = decode(&[&good[1..], good].concat());
    assert_eq!((stats.lines, stats.bad_checksums), (1, 0));
}

#[test]
fn a_line_of_another_product_is_passed_on() {
    let mut bytes = Vec::new();
    encode::text_line(&mut bytes, "VNINS,1,2,3", ChecksumKind::Crc16);
    let (events, stats) = decode(&bytes);
    assert_eq!(events, [Owned::Other("VNINS,1,2,3".to_owned())]);
    assert_eq!(stats.lines, 1);
}

#[test]
fn a_line_longer_than_the_limit_is_garbage() {
    let mut bytes = Vec::new();
    encode::text_line(&mut bytes, &format!("VNYPR,{}", "1".repeat(400)), ChecksumKind::Xor8);
    let (_, stats) = decode(&bytes);
    assert_eq!((stats.lines, stats.bad_checksums, stats.garbage_bytes), (0, 1, bytes.len() as u64));
}

#[test]
fn garbage_costs_no_intact_frame_and_makes_no_false_one() {
    // 4 MB of random bytes with a frame after every random stretch (reliability: garbage between frames)
    let header = BinaryHeader::parse_register("01,0609").unwrap();
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut stream = Vec::new();
    let mut sent = Vec::new();
    while stream.len() < 4_000_000 {
        for _ in 0..random() % 400 {
            stream.push((random() >> 24) as u8);
        }
        let mut measurement = Measurement::new(MeasurementKind::Binary(header));
        measurement.device_time_ns = Some(1000 * sent.len() as u64);
        measurement.set(Quantity::UncompGyro, &[f64::from((random() >> 40) as f32), 0.0, 0.0]);
        encode::measurement(&mut stream, &measurement, ChecksumKind::Xor8);
        sent.push(measurement.device_time_ns);
    }
    let (events, stats) = decode_pieces(stream.chunks(1777), DecoderOptions { binary: BinaryAcceptance::Only(header) });
    let received: Vec<_> = measurements(&events).iter().map(|measurement| measurement.device_time_ns).collect();
    assert!(received == sent, "{} of {} frames", received.len(), sent.len());
    assert_eq!(stats.garbage_bytes, (stream.len() - sent.len() * header.frame_bytes()) as u64);
    assert_eq!(stats.bad_checksums, 0);
}

fn any_header() -> impl Strategy<Value = BinaryHeader> {
    let [common, time, imu, attitude] = KNOWN_BITS;
    (any::<[u16; 4]>(), 1_u8..16).prop_filter_map("no field", move |(masks, groups)| {
        let keep = |index: usize, known: u16| if groups & (1 << index) == 0 { 0 } else { masks[index] & known };
        BinaryHeader::new(keep(0, common), keep(1, time), keep(2, imu), keep(3, attitude)).ok()
    })
}

fn binary_measurement() -> impl Strategy<Value = Measurement> {
    (any_header(), any::<[u64; 2]>(), any::<[u32; 2]>(), any::<[u16; 3]>(), any::<u8>(), any::<[[f32; 32]; 2]>())
        .prop_map(|(header, times, counts, words, status, floats)| {
            let mut measurement = Measurement::new(MeasurementKind::Binary(header));
            measurement.device_time_ns = Some(times[0]);
            measurement.time_sync_in_ns = Some(times[1]);
            (measurement.sync_in_count, measurement.sync_count) = (Some(counts[0]), Some(counts[1]));
            (measurement.vpe_status, measurement.imu_status) = (Some(words[0]), Some(words[1]));
            (measurement.sensor_saturation, measurement.time_status) = (Some(words[2]), Some(status));
            let mut floats =
                floats.into_iter().flatten().map(|value| if value.is_nan() { 0.0 } else { f64::from(value) });
            for quantity in header.quantities().iter() {
                let values: Vec<f64> = floats.by_ref().take(quantity.components()).collect();
                measurement.set(quantity, &values);
            }
            measurement
        })
}

fn ascii_measurement() -> impl Strategy<Value = Measurement> {
    let appendix = (proptest::option::of(any::<u32>()), proptest::option::of(any::<u16>()));
    (proptest::sample::select(&AsciiType::ALL[..]), any::<[i32; 13]>(), appendix).prop_map(
        |(ascii, numbers, (count, status))| {
            let mut measurement = Measurement::new(MeasurementKind::Ascii(ascii));
            let mut numbers = numbers.into_iter();
            for quantity in ascii.quantities() {
                let scale = 10_f64.powi(i32::try_from(quantity.ascii_format().decimals).unwrap());
                let values: Vec<f64> = numbers
                    .by_ref()
                    .take(quantity.components())
                    .map(|number| f64::from(number % 99_999_999) / scale)
                    .collect();
                measurement.set(*quantity, &values);
            }
            (measurement.sync_count, measurement.vpe_status) = (count, status);
            measurement
        },
    )
}

fn any_measurement() -> impl Strategy<Value = (Measurement, ChecksumKind)> {
    let checksum = prop_oneof![Just(ChecksumKind::Xor8), Just(ChecksumKind::Crc16)];
    (prop_oneof![binary_measurement(), ascii_measurement()], checksum)
}

#[derive(Debug, Clone)]
enum Piece {
    Good(Vec<u8>),
    Garbage(Vec<u8>),
}

/// Returns a stretch of a stream: frames, garbage (random, or bytes that look like the beginning of something), damaged
/// frames.
fn piece() -> impl Strategy<Value = Piece> {
    let frame = any_measurement().prop_map(|(measurement, checksum)| {
        let mut bytes = Vec::new();
        encode::measurement(&mut bytes, &measurement, checksum);
        bytes
    });
    let frame = frame.boxed();
    let mark = proptest::sample::select(vec![
        &b"$"[..],
        b"$V",
        b"$VN",
        b"$VNYMR,",
        b"\xFA",
        b"\xFA\x01",
        b"\xFA\x01\x09\x06",
        b"\xFA\x17\x3D\x3F",
        b"\r\n",
        b"*4B\r\n",
        b"$VNRRG,01,x*00\r\n",
    ]);
    prop_oneof![
        4 => frame.clone().prop_map(Piece::Good),
        1 => proptest::collection::vec(any::<u8>(), 0..40).prop_map(Piece::Garbage),
        1 => mark.prop_map(|mark| Piece::Garbage(mark.to_vec())),
        1 => (frame.clone(), any::<proptest::sample::Index>(), 0..8_u8).prop_map(|(mut bytes, index, bit)| {
            let at = index.index(bytes.len());
            bytes[at] ^= 1 << bit;
            Piece::Garbage(bytes)
        }),
        1 => (frame, any::<proptest::sample::Index>()).prop_map(|(mut bytes, index)| {
            bytes.truncate(index.index(bytes.len()));
            Piece::Garbage(bytes)
        }),
    ]
}

fn good_bytes(events: &[Owned]) -> Vec<Measurement> {
    measurements(events).into_iter().cloned().collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn any_split_gives_the_same_events(
        pieces in proptest::collection::vec(piece(), 0..24),
        cuts in proptest::collection::vec(1_usize..40, 1..50),
    ) {
        let stream: Vec<u8> = pieces.iter().flat_map(|(Piece::Good(bytes) | Piece::Garbage(bytes))| bytes.clone()).collect();
        let options = DecoderOptions::default();
        let (whole, stats) = decode_pieces([&stream[..]], options);
        let mut parts = Vec::new();
        let mut rest = &stream[..];
        for cut in cuts.iter().cycle() {
            if rest.is_empty() {
                break;
            }
            let (part, behind) = rest.split_at(rest.len().min(*cut));
            parts.push(part);
            rest = behind;
        }
        prop_assert_eq!(&decode_pieces(parts, options), &(whole.clone(), stats));
        prop_assert_eq!(&decode_pieces(stream.chunks(1), options), &(whole, stats));
    }

    #[test]
    fn good_frames_between_garbage_are_never_lost(pieces in proptest::collection::vec(piece(), 0..24)) {
        let stream: Vec<u8> = pieces.iter().flat_map(|(Piece::Good(bytes) | Piece::Garbage(bytes))| bytes.clone()).collect();
        let mut expected = Vec::new();
        for piece in &pieces {
            if let Piece::Good(bytes) = piece {
                expected.extend(good_bytes(&decode(bytes).0));
            }
        }
        let (events, stats) = decode(&stream);
        let mut found = good_bytes(&events).into_iter();
        // Damaged frames of the stream may also be frames by chance; the sent frames are present, in order.
        for sent in &expected {
            prop_assert!(found.any(|found| same(&found, sent)), "lost: {:?} of {:?}", sent.kind, stats);
        }
    }

    #[test]
    fn what_is_encoded_is_decoded((measurement, checksum) in any_measurement()) {
        let mut bytes = Vec::new();
        encode::measurement(&mut bytes, &measurement, checksum);
        let (events, stats) = decode(&bytes);
        prop_assert_eq!((events.len(), stats.garbage_bytes), (1, 0));
        let found = good_bytes(&events);
        prop_assert_eq!(found[0].kind, measurement.kind);
        for quantity in measurement.kind.quantities().iter() {
            let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(found[0].get(quantity).map(bits), measurement.get(quantity).map(bits));
        }
        if let MeasurementKind::Binary(header) = measurement.kind {
            prop_assert_eq!(bytes.len(), header.frame_bytes());
            prop_assert_eq!(found[0].device_time_ns, measurement.device_time_ns.filter(|_| header.has_time_startup()));
        } else {
            prop_assert_eq!((found[0].sync_count, found[0].vpe_status), (measurement.sync_count, measurement.vpe_status));
        }
        let mut again = Vec::new();
        encode::measurement(&mut again, &found[0], checksum);
        prop_assert_eq!(again, bytes);
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let (_, stats) = decode(&bytes);
        prop_assert_eq!(stats.bytes_in, bytes.len() as u64);
    }
}

/// Returns whether both are equal bit for bit, so that infinities and negative zeros count.
fn same(one: &Measurement, other: &Measurement) -> bool {
    let bits = |measurement: &Measurement| {
        let mut bytes = Vec::new();
        encode::measurement(&mut bytes, measurement, ChecksumKind::Crc16);
        bytes
    };
    bits(one) == bits(other)
}
