"""One symbolic graph, evaluated for millions of samples a second: CasADi to LLVM vector code."""
