"""The other end of drivers/tests/dbc_peers.rs: cantools encodes and decodes, python-can reads and writes the frames.

peer.py encode DBC COUNT SEED LOG   writes COUNT random frames to LOG (candump's format), their values to stdout
peer.py decode DBC LOG              reads the frames in LOG, writes their values to stdout

A line of values: MESSAGE Signal=BITS ..., BITS being the 16 hex digits of the value as an IEEE double.
"""

import random
import struct
import sys

import can
import cantools


def line(message, values):
    parts = [f"{name}={struct.pack('>d', float(value)).hex()}" for name, value in values.items()]
    return " ".join([message.name, *parts])


def random_raw(signal, rng):
    """Often at an end of the range, where mistakes are."""
    if signal.is_float:
        if signal.length == 64:
            return rng.choice([0.0, rng.uniform(-1e6, 1e6), rng.uniform(-1, 1) * 10.0 ** rng.randint(-300, 300)])
        value = rng.choice([0.0, rng.uniform(-1e6, 1e6), rng.uniform(-1, 1) * 10.0 ** rng.randint(-30, 38)])
        return struct.unpack("<f", struct.pack("<f", value))[0]
    low, high = (-(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1) if signal.is_signed else (0, (1 << signal.length) - 1)
    return rng.choice([low, high, rng.randint(low, high), rng.randint(low, high), rng.randint(low, high)])


def choose(message, tree, rng, values):
    """Values for the signals of a tree: a name, or a multiplexor with the trees of its values."""
    for node in tree:
        if isinstance(node, str):
            signal = message.get_signal_by_name(node)
            values[node] = signal.raw_to_scaled(random_raw(signal, rng), decode_choices=False)
        else:
            for name, trees in node.items():
                value = rng.choice(sorted(trees))
                values[name] = value
                choose(message, trees[value], rng, values)


def encode(database, count, seed, log):
    rng = random.Random(seed)
    messages = [m for m in database.messages if m.length <= 8 and m.signals]
    with can.CanutilsLogWriter(log, channel="vcan0") as writer:
        for k in range(count):
            message = messages[k % len(messages)]
            values = {}
            choose(message, message.signal_tree, rng, values)
            data = message.encode(values, scaling=True, padding=False, strict=False)
            writer.on_message_received(
                can.Message(
                    timestamp=1.0 + k * 1e-3,
                    arbitration_id=message.frame_id,
                    is_extended_id=message.is_extended_frame,
                    data=data,
                    channel="vcan0",
                    check=True,
                )
            )
            print(line(message, values))


def decode(database, log):
    messages = {(m.frame_id, m.is_extended_frame): m for m in database.messages}
    with can.CanutilsLogReader(log) as reader:
        for frame in reader:
            message = messages[frame.arbitration_id, frame.is_extended_id]
            print(line(message, message.decode(frame.data, decode_choices=False, scaling=True)))


def main():
    mode, database, *rest = sys.argv[1:]
    database = cantools.database.load_file(database)
    if mode == "encode":
        count, seed, log = rest
        encode(database, int(count), int(seed), log)
    else:
        decode(database, *rest)


main()
