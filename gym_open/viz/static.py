"""Documents and figures in a recording that are the same at any time."""

import rerun as rr


def log_document(rec: rr.RecordingStream, entity: str, text: str) -> None:
    """Markdown that is the same at any time."""
    rec.log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def log_figure(rec: rr.RecordingStream, entity: str, png: bytes) -> None:
    """A PNG file that is the same at any time."""
    rec.log(entity, rr.EncodedImage(contents=png, media_type="image/png"), static=True)
