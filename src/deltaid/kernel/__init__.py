"""Batch evaluation of CasADi graphs as LLVM vector code: millions of samples per second."""
