"""What a catalogue is on the disk: shards, index, manifest, matrices; written once, checked, mapped."""
