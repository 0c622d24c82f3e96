"""Bags whose chunks are small, so that a short recording has many."""

from tam_calibration.recordings.bag_mcap import McapBlockWriter, McapWriter


def cut_chunks(monkeypatch, most):
    """Let the writer of mcap files begin a new chunk after so many bytes, of single messages and of many at once."""

    def write(self, connection, timestamp, data):
        McapWriter.write(self, connection, timestamp, data)
        if self.chunk.bio.tell() > most:
            self.close_chunk()

    monkeypatch.setattr(McapBlockWriter, "write", write)
    monkeypatch.setattr(McapBlockWriter, "chunk_bytes", most)
