// The derivatives of the solver for a caller of the library.
#pragma GCC visibility push(default)
extern "C" {

// Gradient by parameters and initial state for that by x, u and cost; zero for problems that are not valid.
void dmmv_adjoint(long count, long threads, const Real* parameters, const Real* bounds, const Real* x, const Real* u,
                  const bool* valid, const Real* g_x, const Real* g_u, const Real* g_cost, Real* g_parameters,
                  Real* g_state) {
  using P = Problem;
  constexpr int rows = (P::T + 1) * P::n, entries = P::T * P::m;
  std::memset(g_parameters, 0, sizeof(Real) * count * P::PARAMETERS);
  std::memset(g_state, 0, sizeof(Real) * count * P::n);
#ifdef DMMV_LINEAR_QUADRATIC
  if (dmmv::fits_lanes<P>) {
    dmmv::differentiate_linear_quadratic<P>(
        {count, parameters, bounds, x, u, valid, g_x, g_u, g_cost, g_parameters, g_state}, threads);
    return;
  }
#endif
  dmmv::for_each(count, threads, [=](long i) {
    thread_local dmmv::Adjoint<P> adjoint;
    thread_local std::vector<Real> w(P::NUMBERS + 1);
    if (!valid[i]) return;
    adjoint.prepare(parameters + i * P::PARAMETERS, bounds);
    std::memcpy(adjoint.x, x + i * rows, sizeof(Real) * rows);
    std::memcpy(adjoint.u, u + i * entries, sizeof(Real) * entries);
    adjoint.expand(true);
    adjoint.solve_free(g_x + i * rows, g_u + i * entries);
    std::fill(w.begin(), w.end(), Real(0));
    adjoint.weigh(g_cost[i], w.data());
    P::prelude_adjoint(parameters + i * P::PARAMETERS, w.data(), g_parameters + i * P::PARAMETERS);
    adjoint.by_state(g_x + i * rows, g_cost[i], g_state + i * P::n);
  });
}

}  // extern "C"
#pragma GCC visibility pop
