"""Four logs: PX4, ArduPilot, Parquet and the export of an inertial sensor."""

import struct

import numpy as np
import pandas as pd
from foreign.record import DIRECT, INSPECTED, Foreign
from foreign.truth import ARDUPILOT, AUTOPILOT, INTENSITY_T, SAMPLES, SINGLE, START_S, attitude

BOOT_US = 5_000_000
"""Time of the autopilot at the first sample, µs since it started."""

MAG = "<QQIfffIf"
"""``sensor_mag`` of PX4: two times in µs, device, x, y, z in gauss, errors, temperature."""


def ulog(path, truth):
    """Write four instances of ``sensor_mag``, beside the one magnetometer that the autopilot selected, as PX4 does."""
    formats = [
        "sensor_mag:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
        "uint32_t error_count;float temperature;",
        "vehicle_magnetometer:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;"
        "float[3] magnetometer_ga;uint8_t calibration_count;uint8_t[7] _padding0;",
    ]
    name = b"char[10] sys_name"
    head = [
        ulog_message("B", bytes(40)),
        ulog_message("I", bytes([len(name)]) + name + b"PX4_SITL_1"),
        *(ulog_message("F", each.encode()) for each in formats),
        *(ulog_message("A", struct.pack("<BH", number, number) + b"sensor_mag") for number in range(4)),
        ulog_message("A", struct.pack("<BH", 0, 4) + b"vehicle_magnetometer"),
    ]
    gauss = 1e4 * truth.readings_T
    times = BOOT_US + np.round(1e6 * truth.sensor_time_s).astype(int)
    data = []
    for sample in range(SAMPLES):
        for sensor in range(4):
            time, device = int(times[sample, sensor]), 396_000 + sensor
            content = struct.pack(MAG, time + 150, time, device, *gauss[sample, sensor], 0, 31.5)
            data.append(ulog_message("D", struct.pack("<H", sensor) + content))
        time = int(times[sample, 0])
        selected = struct.pack("<QQIfffB", time + 400, time, 396_000, *(gauss[sample, 0] - 0.004), 1)
        data.append(ulog_message("D", struct.pack("<H", 4) + selected))
    path.write_bytes(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", BOOT_US) + b"".join(head + data))


def ulog_message(kind, content):
    """Return a message of a ULog file."""
    return struct.pack("<HB", len(content), ord(kind)) + content


def dataflash(path, truth):
    """Write MAG of three instances, whole milligauss, and ATT, as the logger of ArduPilot does."""
    mag = "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"
    head = [
        described(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
        described(129, "UNIT", "QbZ", "TimeUS,Id,Label"),
        described(130, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        described(131, "MULT", "Qbd", "TimeUS,Id,Mult"),
        described(140, "MAG", "QBhhhhhhhhhBI", mag),
        described(141, "ATT", "Qccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,Yaw"),
    ]
    units = {"s": "s", "#": "instance", "G": "Gauss", "-": "", "d": "deg"}
    head += [packed(129, "<Qb64s", 0, ord(key), label.encode()) for key, label in units.items()]
    head += [
        packed(131, "<Qbd", 0, ord(key), value) for key, value in {"-": 0, "F": 1e-6, "C": 1e-3, "B": 1e-2}.items()
    ]
    head += [packed(130, "<QB16s16s", 0, 140, b"s#GGGGGGGGG-s", b"F-CCCCCCCCC-F")]
    head += [packed(130, "<QB16s16s", 0, 141, b"sddddd", b"FBBBBB")]
    milligauss = np.round(1e7 * truth.readings_T).astype(int)
    roll, pitch, yaw = np.round(100 * np.degrees(attitude(truth.time_s))).astype(int) % 36_000
    roll, pitch = ((angle + 18_000) % 36_000 - 18_000 for angle in (roll, pitch))
    data = []
    for sample, second in enumerate(truth.time_s):
        time = BOOT_US + round(1e6 * second)
        for sensor in range(3):
            rest = (0, 0, 0, 0, 0, 0, 1, time - 900)
            data.append(packed(140, "<QB9hBI", time, sensor, *milligauss[sample, sensor], *rest))
        turn = roll[sample], roll[sample], pitch[sample], pitch[sample]
        data.append(packed(141, "<QhhhhH", time + 40, *turn, yaw[sample]))
    path.write_bytes(b"".join(head + data))


def packed(kind, form, *values):
    """Return a message of a DataFlash log."""
    return b"\xa3\x95" + bytes([kind]) + struct.pack(form, *values)


SIZES = {"B": 1, "b": 1, "h": 2, "c": 2, "C": 2, "I": 4, "n": 4, "Q": 8, "d": 8, "N": 16, "Z": 64}
"""Bytes of each type of DataFlash that is written here."""


def described(kind, name, form, columns):
    """Return the message of a DataFlash log that describes another, or itself."""
    length = 3 + sum(SIZES[letter] for letter in form)
    return packed(128, "<BB4s16s64s", kind, length, name.encode(), form.encode(), columns.encode())


def parquet(path, truth):
    """Write a table of a laboratory: times with a zone, readings in µT under the names of the instruments."""
    start = pd.Timestamp(START_S, unit="s", tz="UTC")
    table = pd.DataFrame({"acquired": start + pd.to_timedelta(truth.time_s, unit="s")})
    for number in range(12):
        table[f"FGM{number // 3 + 1}_B{'xyz'[number % 3]}_uT"] = 1e-3 * truth.table_nT[:, number]
    table["OPM_total_uT"] = 1e-3 * truth.table_nT[:, 12]
    table.assign(board_temperature_C=23.5, status="ok").to_parquet(path)


def normalised(path, truth):
    """Write the export of an inertial sensor, whose field has the length 1 and no unit."""
    preamble = ["// Start Time: Unknown", "// Sample rate: 25.0Hz", "// Scenario: 4.9", "// Firmware Version: 4.6.0"]
    names = ["PacketCounter", "SampleTimeFine", "Mag_X", "Mag_Y", "Mag_Z"]
    rows = [
        f"{number:05d}\t{round(1e4 * second)}\t" + "\t".join(f"{value:.6f}" for value in reading)
        for number, (second, reading) in enumerate(
            zip(truth.time_s, truth.readings_T[:, 0] / INTENSITY_T, strict=True), start=1
        )
    ]
    path.write_text("\n".join([*preamble, "\t".join(names), *rows, ""]))


LOGS = [
    Foreign("flight.ulg", ulog, DIRECT, AUTOPILOT, "{baseline_m: 0.5, vector_noise_nT: 50.0}\n"),
    Foreign(
        "00000042.BIN",
        dataflash,
        DIRECT,
        ARDUPILOT,
        "{positions_m: [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]], vector_noise_nT: 67.0}\n",
    ),
    Foreign("laboratory.parquet", parquet, INSPECTED),
    Foreign(
        "MT_0001.txt",
        normalised,
        DIRECT,
        SINGLE,
        "{positions_m: [[0, 0, 0]], vector_noise_nT: 5.0}\n",
        sentence=("scale_nT", "--map"),
    ),
]
