"""Batch evaluation of symbolic graphs: CasADi compiled to LLVM vector code, millions of samples a
second."""
