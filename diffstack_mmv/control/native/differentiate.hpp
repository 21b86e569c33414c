// The derivatives of the solver for a caller of the library.
#pragma GCC visibility push(default)
extern "C" {

// Gradient by parameters and initial state for that by x, u and cost; zero for problems that are not valid.
void dmmv_adjoint(long count, long threads, const Real* parameters, const Real* bounds, const Real* x, const Real* u,
                  const bool* valid, const Real* g_x, const Real* g_u, const Real* g_cost, Real* g_parameters,
                  Real* g_state) {
  using P = Problem;
  std::memset(g_parameters, 0, sizeof(Real) * count * P::PARAMETERS);
  std::memset(g_state, 0, sizeof(Real) * count * P::n);
  const dmmv::Slopes given = {count, parameters, bounds, x, u, valid, g_x, g_u, g_cost, g_parameters, g_state};
#ifdef DMMV_LINEAR_QUADRATIC
  if (dmmv::fits_lanes<P>) {
    dmmv::differentiate_linear_quadratic<P>(given, threads);
    return;
  }
#endif
  dmmv::for_each(count, threads, [=](long i) {
    static thread_local dmmv::Adjoint<P> adjoint;
    if (valid[i]) adjoint(given, i);
  });
}

}  // extern "C"
#pragma GCC visibility pop
