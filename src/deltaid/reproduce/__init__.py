"""The paper's examples, from excitation to figures, beside the paper's own numbers."""
