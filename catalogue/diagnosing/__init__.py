"""From a recording and a catalogue to an answer: verdict, evidence, baseline, the machine as found, what to measure."""
