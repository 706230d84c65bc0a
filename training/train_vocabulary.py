"""Train the shipped vocabulary of visual words for A-KAZE descriptors.

usage: python training/train_vocabulary.py OUT.npz FOLDER...

Each FOLDER holds JPEG or PNG pictures; up to 300 of each, evenly spread, are described. The shipped file was made
from pictures of the demonstration building (`scan-venue/rgb` in the folder of `roomfix demo --whole`) and from the
pictures that the global descriptor's codebook was fitted to (app/models/akaze_vocabulary.md).
"""

import sys
from pathlib import Path

from app.vision.images import decode_image, to_gray
from app.vision.local_features import create_extractor
from app.vision.vocabulary import train_vocabulary

WORDS = 1000
PICTURES = 300


def main(out: Path, folders: list[Path]) -> None:
    """Describe the pictures and write the vocabulary."""
    extractor = create_extractor("akaze")
    pictures = []
    for folder in folders:
        paths = sorted(path for path in folder.iterdir() if path.suffix in {".jpg", ".png"})
        for path in paths[:: max(1, len(paths) // PICTURES)][:PICTURES]:
            features = extractor.extract(to_gray(decode_image(path.read_bytes())))
            if len(features):
                pictures.append(features.descriptors)
    vocabulary = train_vocabulary(pictures, WORDS)  # type: ignore[arg-type]
    vocabulary.write(out)
    print(f"{len(vocabulary.words)} words from {len(pictures)} pictures in {out}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
