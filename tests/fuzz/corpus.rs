//! Corpora: small valid inputs, made by this project's own encoders.

use flate2::write::GzEncoder;
use std::io::Write as _;
use vn100_proto::encode::{ascii_message, binary_frame, text_line};
use vn100_proto::{AsciiType, BinaryHeader, ChecksumKind, Measurement, MeasurementKind, Quantity};
use vn100_testkit::bag;
use vn100_testkit::ros2::{self, Cdr};

const ACCEL: [f64; 3] = [-0.077, 0.164, -9.965];

/// Returns the inputs of a target.
pub fn of(target: &str) -> Vec<Vec<u8>> {
    match target {
        "decoder" => decoder(),
        "csv" => csv(),
        "raw_text" => raw_text(),
        "raw_bytes" => raw_bytes(),
        "bag" => bags(),
        "db3" => ros2_recordings(|topics, messages| vec![ros2::db3(topics, messages)]),
        "mcap" => ros2_recordings(|topics, messages| {
            vec![ros2::mcap(topics, messages, true, 3), ros2::mcap(topics, messages, false, usize::MAX)]
        }),
        "table" => tables(),
        "mapped" => mapped(),
        "config" => config(),
        "http" => http(),
        "faults" => faults(),
        other => panic!("no corpus for {other}"),
    }
}

/// Returns byte strings that are worth inserting anywhere in an input of a target.
pub fn dictionary(target: &str) -> &'static [&'static [u8]] {
    match target {
        "decoder" => {
            &[b"$VN", b"$VNYMR,", b"\xFA", b"\xFA\x01\x09\x06", b"*XX\r\n", b"\r\n", b"$VNERR,", b"$VNRRG,", b"T", b"S"]
        }
        "csv" => &[
            b"time_s",
            b"gyro_x_rad_s",
            b"accel_z_mg",
            b"mag_x_tesla",
            b",",
            b"\n",
            b"\r",
            b"\"",
            b"NaN",
            b"\xEF\xBB\xBF",
            b"1e5",
            b"\x1F\x8B",
            b";",
            b"$VN",
        ],
        "raw_text" => &[
            b"$VN",
            b"$VNYMR,",
            b"*",
            b"\t",
            b"\n",
            b"\r\n",
            b" ",
            b"$",
            b"1710358267.5\t",
            b"\x1F\x8B",
            b"time_s,gyro_x_rad_s",
        ],
        "bag" => &[
            b"#ROSBAG V2.0\n",
            b"op=\x05",
            b"op=\x07",
            b"op=\x02",
            b"bz2",
            b"lz4",
            b"none",
            b"conn=",
            b"time=",
            b"size=",
            b"\xFF\xFF\xFF\xFF",
            b"MSG: sensor_msgs/Imu\n",
            b"float64[9] x\n",
            b"string[] x\n",
            b"Header header\n",
            b"===\n",
            b"x/T[4000000000] x\n",
            b"$VN",
            b"BZh9",
            b"\x04\x22\x4D\x18",
        ],
        "raw_bytes" => &[b"\xFA\x01\x09\x06", b"$VNYMR,", b"\xFA", b"\0\0\0\0", b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF"],
        "db3" => &[
            b"topics",
            b"messages",
            b"sensor_msgs/msg/Imu",
            b"cdr",
            b"\0\x01\0\0",
            b"\xFF\xFF\xFF\xFF",
            b"float64[<=9] x\n",
            b"CREATE VIEW",
            b"$VN",
        ],
        "mcap" => &[
            b"\x89MCAP0\r\n",
            b"\x03",
            b"\x04",
            b"\x05",
            b"\x06",
            b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF",
            b"lz4",
            b"zstd",
            b"ros1",
            b"cdr",
            b"\x28\xB5\x2F\xFD",
            b"\x04\x22\x4D\x18",
            b"MSG: sensor_msgs/Imu\n",
        ],
        "table" => &[
            b"\x93NUMPY\x01\0",
            b"PK\x03\x04",
            b"MATLAB 5.0 MAT-file",
            b"\x89HDF\r\n\x1a\n",
            b"ULog\x01\x12\x35",
            b"\xA3\x95\x80",
            b"'descr': '<f8'",
            b"'shape': (4000000000,)",
            b"\xFF\xFF\xFF\xFF",
            b"\xFF\xFF\xFF\xFF\xFF\xFF\xFF\x7F",
            b"time_s",
            b"gyro_x_rad_s",
        ],
        "mapped" => &[
            b"=gyro_x_dps",
            b"#1=time_ms",
            b"rate[0]=",
            b"rate.1=",
            b",",
            b"\n",
            b"0.05 0.2 gyro_x\n",
            b"- - -\n",
            b"1710358267 1710358268 -\n",
            b"1e18 -1e18 ",
            b"int64[] x\n",
            b"uint16[3] rate\n",
        ],
        "config" => &[
            b"[sensor]\n",
            b"[http]\n",
            b"[storage]\n",
            b"[capture]\n",
            b"[log]\n",
            b"listen = ",
            b"\"auto\"",
            b"= ",
            b"rate-hz",
            b"\"\"\"",
            b"\n",
            b"\"5h\"",
            b"[[",
            b"{",
            b".",
            b"0.0.0.0:1",
            b"#",
            b"inf",
            b"1979-05-27",
        ],
        "http" => &[
            b"GET ",
            b"POST ",
            b"/v1/captures/latest/samples?",
            b"/v1/captures/1/",
            b"from=",
            b"to=",
            b"max_points=",
            b"cursor=gaps-1-",
            b"limit=",
            b"%00",
            b"%FF",
            b"%2e%2e/",
            b"&",
            b"?",
            b"/v1/jobs",
            b"\nAccept: ",
            b"\nContent-Type: application/json",
            b"\n\n",
            b"{\"kind\":\"allan\",\"capture\":1}",
            b"format=csv",
            b"channels=gyro_x",
            b"estimator=",
            b"taus=all",
            b"-1",
            b"1e308",
            b"2026-01-01T00:00:00Z",
            b"+",
            b"\nIf-None-Match: ",
        ],
        _ => &[
            b"10s ",
            b"unplug ",
            b"eof ",
            b"reset",
            b"silence ",
            b"garbage ",
            b"checksum ",
            b"drop ",
            b"format VNYMR",
            b"format ",
            b"rate ",
            b"baud ",
            b"hold ",
            b"unit ",
            b"clock ",
            b"\n",
            b"#",
            b"5h",
            b"18446744073709551615",
            b"500ms",
        ],
    }
}

fn measurement(kind: MeasurementKind) -> Measurement {
    let mut measurement = Measurement::new(kind);
    measurement.device_time_ns = Some(123_456_789);
    measurement.sync_count = Some(77);
    for quantity in [Quantity::YawPitchRoll, Quantity::Mag, Quantity::Accel, Quantity::AngularRate] {
        measurement.set(quantity, &[0.1, -0.2, 9.8]);
    }
    measurement
}

fn decoder() -> Vec<Vec<u8>> {
    let mut stream = Vec::new();
    for (common, imu) in [(0x0609, 0), (0x0001, 0x0030)] {
        let header = BinaryHeader::new(common, 0, imu, 0).unwrap();
        binary_frame(&mut stream, &header, &measurement(MeasurementKind::Binary(header)));
    }
    let mut lines = Vec::new();
    for (ascii, checksum) in [
        (AsciiType::Ymr, ChecksumKind::Xor8),
        (AsciiType::Ypr, ChecksumKind::Crc16),
        (AsciiType::Imu, ChecksumKind::Xor8),
    ] {
        ascii_message(&mut lines, ascii, &measurement(MeasurementKind::Ascii(ascii)), checksum);
    }
    for body in ["VNRRG,01,VN-100T-CR", "VNWRG,07,40", "VNERR,03", "VNXYZ,1,2"] {
        text_line(&mut lines, body, ChecksumKind::Xor8);
    }
    let mut inputs = Vec::new();
    for acceptance in 0..3 {
        for stream in [stream.clone(), lines.clone(), [&stream[..], b"garbage\xFA\x01", &lines, &stream[..20]].concat()]
        {
            inputs.push([&[acceptance, 3][..], &stream].concat());
        }
    }
    inputs
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn csv() -> Vec<Vec<u8>> {
    let plain = "time_s,gyro_x_rad_s,accel_z_m_s2,temperature_c\n0,0.1,-9.8,25\n0.025,0.2,,25.5\n0.05,NaN,-9.7,26\n0.2,0.3,-9.9,27\n";
    let converted = "accel_z_mg,note,time_s,gyro_x_dps,mag_y_ut,roll_rad,pressure_kpa,mag_x_tesla\n\
                     1000,a,0,180,50,3.14,101.3,0.00005\n-1000,\"b,c\",0.5,-90,25,0,101,0\n900,d,1,1e-3,2,1,100,0\n";
    let bad = "time_s,gyro_x_rad_s\r\n1710358267.5,1\r\n1710358267.6,two\r\n1710358267.6,2\r\n1710358267.7,3\r\n\r\n1,4\r\n5,6,7\r\n";
    let mut inputs: Vec<Vec<u8>> = [plain, converted, bad].iter().map(|text| text.as_bytes().to_vec()).collect();
    inputs.push(gzip(plain.as_bytes()));
    inputs
}

fn raw_text() -> Vec<Vec<u8>> {
    let line = |index: u32| bag::raw_line([1e-3 * f64::from(index); 3], ACCEL);
    let spliced = |index: u32| format!("{}{}", &line(index)[..60], line(index + 1));
    let plain: String = (0..8).map(|index| line(index) + "\r\n").collect();
    let stamped = |index: u32, line: String| {
        let seconds = 1_710_358_267.0 + 0.025 * f64::from(index);
        format!("{:.6}\t{seconds:.6}\t{line}\n", seconds + 0.01 * f64::from(index % 2))
    };
    let mut cart: String = (0..6).map(|index| stamped(index, line(index))).collect();
    cart += &stamped(6, line(6).replace("-09.965", "-30945"));
    cart += &stamped(9, line(9));
    cart += &stamped(10, spliced(10));
    cart += &stamped(11, "$VNWRG,07,40*59".to_owned());
    cart += "no stamp here\n";
    cart += &stamped(12, line(12));
    let mixed = format!("{}\n{}\n{}\nhello\n{}\n", line(0), spliced(1), line(2).replace('*', "+"), line(3));
    vec![plain.clone().into_bytes(), cart.into_bytes(), mixed.into_bytes(), gzip(plain.as_bytes())]
}

fn bags() -> Vec<Vec<u8>> {
    let stamp_ns = |index: u64| 1_710_358_267_000_000_000 + 25_000_000 * index;
    let mut records = bag::connection(3, "/imu", bag::DRIVER);
    for index in 0..6 {
        let mut raw = bag::raw_line([1e-6 * index as f64; 3], ACCEL);
        if index == 3 {
            raw = raw.replace("-09.965", "-30945");
        }
        let data = bag::driver(stamp_ns(index), &raw, [1.0; 3], [2.0; 3], [3e-5; 3]);
        records.extend(bag::message(3, stamp_ns(index) + 1000, &data));
    }
    let mut plain = bag::connection(1, "/imu", bag::IMU);
    plain.extend(bag::connection(2, "/text", bag::TEXT));
    for index in [0, 1, 2, 5, 6] {
        plain.extend(bag::message(1, stamp_ns(index), &bag::imu(stamp_ns(index), [1.0; 3], [2.0; 3])));
        plain.extend(bag::message(2, stamp_ns(index), &bag::string("nothing")));
    }
    ["none", "bz2", "lz4"]
        .iter()
        .flat_map(|how| [bag::bag(&[bag::chunk(how, &records)]), bag::bag(&[bag::chunk(how, &plain)])])
        .collect()
}

fn ros2_recordings(write: impl Fn(&[ros2::Topic<'_>], &[ros2::Message]) -> Vec<Vec<u8>>) -> Vec<Vec<u8>> {
    let stamp_ns = |index: u64| 1_710_358_267_000_000_000 + 25_000_000 * index;
    let (mut standard, mut driver) = (Vec::new(), Vec::new());
    for index in [0, 1, 2, 3, 6, 7] {
        let received_ns = stamp_ns(index) as i64 + 1000;
        let imu = Cdr::little_endian().imu(stamp_ns(index), [1e-3; 3], ACCEL);
        let field = Cdr::big_endian().magnetic_field(stamp_ns(index), [3e-5; 3]);
        standard.extend([(0, received_ns, imu.bytes()), (1, received_ns, field.bytes())]);
        let raw = bag::raw_line([1e-6 * index as f64; 3], ACCEL);
        let message = Cdr::little_endian().header(stamp_ns(index)).imu(0, [1.0; 3], [2.0; 3]);
        driver.push((0, received_ns, message.magnetic_field(0, [3e-5; 3]).text(&raw).bytes()));
    }
    let imu = ("/imu", "sensor_msgs/msg/Imu", Some(ros2::IMU_DEFINITION));
    let topics = [imu, ("/mag", "sensor_msgs/msg/MagneticField", None)];
    let mut recordings = write(&topics, &standard);
    recordings.extend(write(&[("/imu", "imu_msg/msg/IMUmsg", None)], &driver));
    recordings
}

/// Returns small files of the forms of other programs, written by those forms' own libraries
/// (`crates/imu-files/tests/recordings`).
fn tables() -> Vec<Vec<u8>> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/imu-files/tests/recordings");
    let files = [
        "table.npy",
        "structured.npy",
        "fortran.npy",
        "arrays.npz",
        "arrays_compressed.npz",
        "matlab5.mat",
        "matlab5_compressed.mat",
        "matlab5_struct.mat",
        "matlab73.mat",
        "groups.h5",
        "px4.ulg",
        "ardupilot.bin",
        "utf16_le.csv",
        "plain.csv.bz2",
        "plain.csv.xz",
        "plain.csv.zst",
    ];
    files.map(|file| std::fs::read(folder.join(file)).unwrap()).to_vec()
}

fn mapped() -> Vec<Vec<u8>> {
    let stamp_ns = |index: u64| 1_710_358_267_000_000_000 + 25_000_000 * index;
    let definition = "std_msgs/Header header\nint32[3] rate\nfloat64[] force\n";
    let messages: Vec<ros2::Message> = (0..8)
        .map(|index| {
            let cdr = Cdr::little_endian().header(stamp_ns(index)).number(7).number(8).number(index as u32);
            (0, stamp_ns(index) as i64, cdr.number(2).wide(&[0.5, 9.8]).bytes())
        })
        .collect();
    let bag = ros2::db3(&[("/raw", "own_msgs/msg/Raw", Some(definition))], &messages);
    let rows: String = (0..20).map(|row| format!("{},{},{}\n", 25 * row, row, -row)).collect();
    let with = |head: &str, bytes: &[u8]| [head.as_bytes(), bytes].concat();
    vec![
        with("rate[0]=gyro_x_deg_s,rate.2=gyro_z_rad_s,force[1]=accel_z_m_s2\n- 0.1 -\n", &bag),
        with("t=time_ms,a=gyro_x_dps,b=accel_z_g\n0.1 0.3 gyro_x\n", format!("t,a,b\n{rows}").as_bytes()),
        with("#1=time_ms,#2=gyro_x_dps\n- - -\n", rows.as_bytes()),
        with(",\n0.05 0.2 -\n", &csv()[0]),
    ]
}

fn raw_bytes() -> Vec<Vec<u8>> {
    let mut streams = Vec::new();
    for (common, imu) in [(0x0609, 0), (0x0001, 0x0030), (0x0108, 0)] {
        let header = BinaryHeader::new(common, 0, imu, 0).unwrap();
        let mut stream = Vec::new();
        for index in [1, 2, 3, 7, 8, 2, 3] {
            let mut measurement = measurement(MeasurementKind::Binary(header));
            measurement.device_time_ns = Some(index * 600_000_000);
            binary_frame(&mut stream, &header, &measurement);
        }
        stream.extend(bag::raw_line([1e-3; 3], ACCEL).as_bytes());
        stream.extend(b"\r\ngarbage\xFA\x01");
        streams.push(stream);
    }
    streams
}

fn config() -> Vec<Vec<u8>> {
    let shipped = include_str!("../../systemd/vn100d.toml");
    let uncommented: String = shipped
        .lines()
        .filter(|line| !line.starts_with("# ") && !line.contains("token-file"))
        .map(|line| line.trim_start_matches('#').to_owned() + "\n")
        .collect();
    let small = "[sensor]\ndevice = \"/dev/ttyUSB0\"\nbaud = 921600\nrate-hz = 200\n[http]\nlisten = \"127.0.0.1:1\"\n";
    vec![uncommented.into_bytes(), small.as_bytes().to_vec(), b"[log]\nlevel = \"debug\"\n".to_vec()]
}

fn http() -> Vec<Vec<u8>> {
    let requests = [
        "GET /v1/captures/latest/samples?channels=gyro_x,accel_z&from=0&to=5&max_points=10&format=csv",
        "GET /v1/captures/1/samples?from=2027-01-15T08:00:00Z\nAccept: application/x-ndjson",
        "GET /v1/captures/1/gaps?limit=1",
        "GET /v1/captures/1/segments?limit=1&cursor=segments-1-1",
        "GET /v1/captures/1/events",
        "GET /v1/captures?limit=10",
        "GET /v1/captures/latest/plots/allan-gyro_x.svg?beside=1",
        "GET /compare?a=&b=1",
        "GET /v1/captures/latest/statistics",
        "GET /v1/captures/latest/allan\nIf-None-Match: \"x\"",
        "GET /v1/captures/latest/noise",
        "GET /v1/jobs?state=done&limit=5",
        "GET /v1/models/model-1/cost?horizons=1s,10s&align=5s&tolerance=heading=1deg/1min",
        "POST /v1/jobs\nContent-Type: application/json\n\n{\"kind\":\"allan\",\"capture\":1}",
        "POST /v1/captures\nContent-Type: application/json\n\n{\"duration\":\"5h\",\"name\":\"x\"}",
        "POST /v1/captures/1/pin",
        "GET /metrics",
        "GET /v1/status",
        "GET /openapi.json",
        "HEAD /healthz",
        "DELETE /v1/jobs/1",
    ];
    requests.iter().map(|request| request.as_bytes().to_vec()).collect()
}

fn faults() -> Vec<Vec<u8>> {
    let all = "# a night\n10s unplug 10s\n20s eof 10s\n30s reset\n40s silence 5s\n50s garbage 4096\n60s checksum 20\n70s drop 7\n\
               80s duplicate 3\n90s reorder 1\n100s rate 100\n110s format VNYMR\n120s baud 9600\n130s hold 2s # burst\n\
               140s unit 0100099999\n150s clock 4294967290\n160s format 01,0609\n";
    vec![all.as_bytes().to_vec(), b"0s drop 1\n".to_vec(), b"1h30m hold 500ms\n".to_vec()]
}
