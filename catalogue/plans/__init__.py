"""Plans: which hypotheses a catalogue holds, and what is drawn for each of their cases."""
