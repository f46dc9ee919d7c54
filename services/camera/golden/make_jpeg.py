"""Writes the JPEG files of this folder, and the gray values that a reader must find in them.

The oracle is libjpeg, by Pillow: nothing of the camera's code is used. Run: pip install pillow; python3 make_jpeg.py
"""

from PIL import Image

WIDTH, HEIGHT = 33, 18


def luminance(red, green, blue):
    return (2126 * red + 7152 * green + 722 * blue + 5000) // 10000


picture = Image.new("RGB", (WIDTH, HEIGHT))
picture.putdata([(7 * x, 13 * y, 255 - 3 * x - 5 * y) for y in range(HEIGHT) for x in range(WIDTH)])
for name, mode, options in [
    ("rgb", "RGB", {}),
    ("rgb_progressive", "RGB", {"progressive": True, "subsampling": 0}),
    ("gray", "L", {}),
]:
    picture.convert(mode).save(name + ".jpg", quality=95, **options)
    decoded = Image.open(name + ".jpg").convert("RGB")
    with open(name + "_jpg.csv", "w") as file:
        for y in range(HEIGHT):
            file.write(",".join(str(luminance(*decoded.getpixel((x, y)))) for x in range(WIDTH)) + "\n")
