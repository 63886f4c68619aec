"""From a recording and a catalogue to an answer: verdict, evidence, baseline, synthesis, what else to measure."""
