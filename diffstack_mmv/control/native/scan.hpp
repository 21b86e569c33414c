// Rows stepped forward side by side, eight at a time, shared among threads.
#pragma GCC visibility push(default)
extern "C" {

// state (count, n), inputs (count, steps, k) -> states (count, steps + 1, n), outputs (count, steps, r)
void dmmv_scan(long count, long threads, long steps, const Real* parameters, const Real* state, const Real* inputs,
               Real* states, Real* outputs) {
  using P = Problem;
  using namespace dmmv;
  constexpr int n = P::n, k = P::inputs, r = P::outputs;
  Real q[P::NUMBERS + 1];
  P::prelude(parameters, q);
  for_each((count + LANES - 1) / LANES, threads, [&](long group) {
    const long first = group * LANES;
    const int lanes = int(count - first < LANES ? count - first : LANES);
    Pack x[n], u[k + 1], y[n + r];
    for (int lane = 0; lane < LANES; ++lane) {
      const long row = first + (lane < lanes ? lane : 0);
      for (int i = 0; i < n; ++i) x[i][lane] = state[row * n + i];
    }
    for (long t = 0; t <= steps; ++t) {
      for (int lane = 0; lane < lanes; ++lane)
        for (int i = 0; i < n; ++i) states[((first + lane) * (steps + 1) + t) * n + i] = x[i][lane];
      if (t == steps) break;
      for (int lane = 0; lane < LANES; ++lane) {
        const long row = first + (lane < lanes ? lane : 0);
        for (int i = 0; i < k; ++i) u[i][lane] = inputs[(row * steps + t) * k + i];
      }
      P::step(x, u, q, y);
      for (int i = 0; i < n; ++i) x[i] = y[i];
      for (int lane = 0; lane < lanes; ++lane)
        for (int i = 0; i < r; ++i) outputs[((first + lane) * steps + t) * r + i] = y[n + i][lane];
    }
  });
}

}  // extern "C"
#pragma GCC visibility pop
