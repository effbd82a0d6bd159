"""The paper's examples, from excitation to figures, compared with the paper's own numbers."""
