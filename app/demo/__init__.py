"""The demo: a catalogue built on this computer, and three recordings diagnosed with it."""
