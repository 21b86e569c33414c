// What a caller of the library sees.
#pragma GCC visibility push(default)
extern "C" {

struct dmmv_sizes {
  int state, control, steps, parameters, bytes;
};

dmmv_sizes dmmv_describe() { return {Problem::n, Problem::m, Problem::T, Problem::PARAMETERS, int(sizeof(Real))}; }

// Solves `count` problems, row-major arrays: parameters (count, parameters), bounds (2, control), state (count, state),
// controls (count, steps, control), x (count, steps + 1, state), u (count, steps, control), all others (count).
void dmmv_solve(long count, long threads, const Real* parameters, const Real* bounds, const Real* state, const Real* controls,
                const dmmv::Settings* settings, Real* x, Real* u, Real* cost, Real* residual, long* iterations,
                long* status) {
  using P = Problem;
  std::fill(status, status + count, long(dmmv::OPEN));
#ifdef DMMV_LINEAR_QUADRATIC
  if (dmmv::fits_lanes<P>)
    dmmv::solve_linear_quadratic<P>(count, threads, parameters, bounds, state, controls, *settings,
                                    {x, u, cost, residual, iterations, status});
#endif
  dmmv::for_each(count, threads, [=](long i) {
    if (status[i] != dmmv::OPEN) return;
    thread_local dmmv::Solver<P> solver;
    solver.prepare(parameters + i * P::PARAMETERS, bounds);
    solver.solve(state + i * P::n, controls + i * P::T * P::m, *settings);
    residual[i] = solver.conclude();
    std::memcpy(x + i * (P::T + 1) * P::n, solver.x, sizeof(solver.x));
    std::memcpy(u + i * P::T * P::m, solver.u, sizeof(solver.best.u));
    cost[i] = solver.cost;
    iterations[i] = solver.iterations;
    status[i] = solver.status;
  });
}

}  // extern "C"
#pragma GCC visibility pop
