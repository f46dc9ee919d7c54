"""Writes the PNG files of this folder, chunk by chunk, and the gray values that a reader must find in them.

The one oracle here is the PNG specification: nothing of the camera's code is used. Run: python3 make.py
"""

import struct
import zlib

WIDTH, HEIGHT = 13, 7
ADAM7 = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]


def color(x, y):
    """Red, green, blue and alpha, 16 bits each."""
    return [(x * 4801 + y * 977) % 65536, (x * 313 + y * 9011) % 65536, (x * x * 401 + y * 53) % 65536, 40000]


def luminance(red, green, blue):
    return (2126 * red + 7152 * green + 722 * blue + 5000) // 10000


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def save(name, depth, kind, pixel, extra=b"", interlaced=False):
    passes = ADAM7 if interlaced else [(0, 0, 1, 1)]
    raw = b""
    for x0, y0, dx, dy in passes:
        if x0 >= WIDTH or y0 >= HEIGHT:
            continue
        for y in range(y0, HEIGHT, dy):
            values = [value for x in range(x0, WIDTH, dx) for value in pixel(x, y)]
            if depth == 16:
                line = b"".join(struct.pack(">H", value) for value in values)
            elif depth == 8:
                line = bytes(values)
            else:
                bits = "".join(format(value, f"0{depth}b") for value in values)
                bits += "0" * (-len(bits) % 8)
                line = bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))
            raw += b"\0" + line
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, depth, kind, 0, 0, int(interlaced))
    with open(name + ".png", "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra)
        file.write(chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def values(name, gray):
    with open(name + ".csv", "w") as file:
        for y in range(HEIGHT):
            file.write(",".join(str(gray(x, y)) for x in range(WIDTH)) + "\n")


def rgb8(x, y):
    return [value >> 8 for value in color(x, y)[:3]]


save("gray8", 8, 0, lambda x, y: [color(x, y)[0] >> 8])
save("gray8_interlaced", 8, 0, lambda x, y: [color(x, y)[0] >> 8], interlaced=True)
save("gray16", 16, 0, lambda x, y: color(x, y)[:1])
save("gray_alpha8", 8, 4, lambda x, y: [color(x, y)[0] >> 8, 100])
save("gray1", 1, 0, lambda x, y: [(x + y) % 2])
save("rgb8", 8, 2, rgb8)
save("rgb8_interlaced", 8, 2, rgb8, interlaced=True)
save("rgba16", 16, 6, color)
save("palette4", 4, 3, lambda x, y: [(3 * x + 5 * y) % 16],
     chunk(b"PLTE", bytes(value for i in range(16) for value in (15 * i, 255 - 9 * i, 7 * i))))

values("gray", lambda x, y: color(x, y)[0] >> 8)
values("gray1", lambda x, y: 255 * ((x + y) % 2))
values("rgb", lambda x, y: luminance(*rgb8(x, y)))
values("palette", lambda x, y: (lambda i: luminance(15 * i, 255 - 9 * i, 7 * i))((3 * x + 5 * y) % 16))
