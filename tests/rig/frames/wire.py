"""Frames built bit by bit as ISO 11898-1 has them on the wire, and their lengths."""

from can_rig.frames.frame_length import FrameBits


def bits_of(number, width):
    return [number >> (width - 1 - i) & 1 for i in range(width)]


def identifier(message, rtr):
    """SOF to IDE or, of 29 bits, to RTR or RRS."""
    if message.is_extended_id:
        base, more = divmod(message.arbitration_id, 1 << 18)
        return [0, *bits_of(base, 11), 1, 1, *bits_of(more, 18), rtr]
    return [0, *bits_of(message.arbitration_id, 11), rtr, 0]


def with_stuff_bits(bits):
    """The wire, one bit at a time; (bit, how many bits of the frame went before it)."""
    wire = []
    for sent, bit in enumerate(bits):
        wire.append((bit, sent))
        last = [b for b, _ in wire[-5:]]
        if len(last) == 5 and len(set(last)) == 1:
            wire.append((1 - bit, sent + 1))
    return wire


def crc(bits, polynomial, width):
    """The shift register of the standard: CRC_NXT, shift, exclusive or."""
    register = 0
    for bit in bits:
        following = bit ^ register >> (width - 1)
        register = (register << 1) & ((1 << width) - 1)
        if following:
            register ^= polynomial
    return register


def classic(message):
    """Bits of a classic frame on the wire."""
    reserved = [0, 0] if message.is_extended_id else [0]
    bits = identifier(message, int(message.is_remote_frame)) + reserved + bits_of(message.dlc, 4)
    if not message.is_remote_frame:
        bits += [bit for byte in message.data for bit in bits_of(byte, 8)]
    bits += bits_of(crc(bits, 0x4599, 15), 15)
    assert crc(bits, 0x4599, 15) == 0  # what a receiver finds
    return FrameBits(len(with_stuff_bits(bits)) + len([1] + [0, 1] + [1] * 7))


def flexible(message):
    """Bits of an FD frame on the wire, at each rate."""
    arbitration = [*identifier(message, 0), 1, 0, int(message.bitrate_switch)]  # FDF res BRS
    dlc = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64).index(len(message.data))
    rest = [int(message.error_state_indicator), *bits_of(dlc, 4)]
    rest += [bit for byte in message.data for bit in bits_of(byte, 8)]
    wire = with_stuff_bits(arbitration + rest)
    if wire[-1][1] == len(arbitration + rest):
        wire.pop()  # there the fixed stuff bit comes
    nominal = sum(sent < len(arbitration) for _, sent in wire)
    check = bits_of(0, 4 + (17 if len(message.data) <= 16 else 21))  # their values change no length
    field = []
    for place, bit in enumerate(check):
        field += [1 - bit, bit] if place % 4 == 0 else [bit]
    data = len(wire) - nominal + len(field) + 1  # and the CRC delimiter
    tail = 1 + 1 + 7
    if message.bitrate_switch:
        return FrameBits(nominal + tail, data)
    return FrameBits(nominal + tail + data)
