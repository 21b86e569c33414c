// One step of a model for many rows, eight at once.
#pragma once
#include "stage.hpp"

#pragma GCC visibility push(default)
extern "C" {

// Row-major: parameters (PARAMETERS), state (count, n), control (count, m) -> following (count, n).
void dmmv_step(long count, long threads, const Real* parameters, const Real* state, const Real* control,
               Real* following) {
  using namespace dmmv;
  using P = Problem;
  constexpr int n = P::n, m = P::m;
  Real q[P::NUMBERS + 1];
  P::prelude(parameters, q);
  const Real* numbers = q;
  for_each((count + LANES - 1) / LANES, threads, [=](long block) {
    const long first = block * LANES, rows = count - first < LANES ? count - first : LANES;
    Pack x[n], u[m], y[n];
    for (int lane = 0; lane < LANES; ++lane) {
      const long row = first + (lane < rows ? lane : 0);  // filled up with copies
      for (int i = 0; i < n; ++i) x[i][lane] = state[row * n + i];
      for (int i = 0; i < m; ++i) u[i][lane] = control[row * m + i];
    }
    P::step(x, u, numbers, y);
    for (int lane = 0; lane < rows; ++lane)
      for (int i = 0; i < n; ++i) following[(first + lane) * n + i] = y[i][lane];
  });
}

}  // extern "C"
#pragma GCC visibility pop
