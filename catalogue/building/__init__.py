"""From a plan to a catalogue: chunks, workers, clusters; killed at any time and taken up again."""
