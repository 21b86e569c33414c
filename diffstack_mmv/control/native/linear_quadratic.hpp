// Linear-quadratic problems in a box: active sets by pivoting, where that fails by an interior-point method; what
// neither solves is left to the iterations.
#pragma once
#include "interior.hpp"

namespace dmmv {

// where results go, as in `dmmv_solve`
struct Results {
  Real *x, *u, *cost, *residual;
  long *iterations, *status;
};

template <class P>
struct LinearQuadratic : Interior<P> {
  static constexpr int n = P::n, m = P::m, T = P::T;
  static constexpr int GUESSES_FIRST = 12, PATIENCE = 3;
  using Base = Interior<P>;
  using Base::x, Base::u, Base::gradient, Base::box, Base::du, Base::Q_uu, Base::found, Base::inverse, Base::one;

  const Real *parameters, *state, *guess;
  Settings settings;
  Results to;
  long problem[LANES];  // of each lane; those beyond `count` repeat the last one
  int count;

  // takes up problems; the number of recursions before is none
  void take(const long* numbers, int count_) {
    bool all_new = false;
    count = count_;
    for (int lane = 0; lane < LANES; ++lane) {
      const long i = problem[lane] = numbers[lane < count ? lane : count - 1];
      all_new = this->load(lane, parameters + i * P::PARAMETERS) || all_new;
      for (int j = 0; j < n; ++j) x[0][j][lane] = state[i * n + j];
      for (int t = 0; t < T; ++t)
        for (int j = 0; j < m; ++j) u[t][j][lane] = clipped(guess[(i * T + t) * m + j], box[0][j], box[1][j]);
    }
    if (all_new) this->begin();
    this->differentiate();
    this->guess_sides();
    this->renew(all_new);
  }

  Mask lanes() const {
    Mask own = {};
    for (int lane = 0; lane < count; ++lane) own[lane] = -1;
    return own & (this->convex > Pack{});
  }

  // problems in reach of a few guesses
  void solve_by_pivoting() {
    this->pivot(std::min(GUESSES_FIRST, settings.max_iterations), PATIENCE);
    finish(lanes() & found, 0);
  }

  void solve_by_interior() {
    Base::interior(lanes(), settings.max_iterations, [&](const Mask& done, int used) { finish(done, used); });
  }

  // one more step of Newton's method with the active sets held, which tells whether the lanes have converged
  void finish(const Mask& done, int used) {
    if (!any(done)) return;
    clip();
    this->differentiate();
    this->template correct<false>(gradient);
    const Pack promised = this->decrease, noise = this->change;
    Pack slope = {}, residual = {};
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Pack g = gradient[t][i], to_low = box[0][i] - u[t][i], to_high = box[1][i] - u[t][i];
        slope -= g * least(most(-g / Q_uu[t][i * m + i], to_low), to_high);
        u[t][i] += du[t][i];
      }
    for (int t = 0; t <= T; ++t)
      for (int i = 0; i < n; ++i) x[t][i] += this->dx[t][i];
    clip();
    this->gradients();
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Pack moved = between(u[t][i] - gradient[t][i], box[0][i], box[1][i]);
        residual = most(residual, magnitude(u[t][i] - moved));
      }
    for (int lane = 0; lane < count; ++lane)
      if (done[lane]) write(lane, used + int(this->guesses[lane]) + 1, promised[lane], slope[lane], noise[lane], residual[lane]);
  }

  void clip() {
    for (auto& row : u)
      for (int i = 0; i < m; ++i) row[i] = between(row[i], box[0][i], box[1][i]);
  }

  // states, cost and the sum of its magnitudes by the functions of the problem; the policy undoes what rounding does
  void roll(int lane, Real* own_x, Real* own_u, Real& cost, Real& magnitude_) {
    const Real none[m] = {};
    Real each;
    for (int j = 0; j < n; ++j) own_x[j] = state[problem[lane] * n + j];
    cost = magnitude_ = 0;
    for (int t = 0; t <= T; ++t) {
      const Real *now = own_x + t * n, *control = t < T ? own_u + t * m : none;
      for (int i = 0; t < T && i < m; ++i) {
        Real c = u[t][i][lane];
        for (int j = 0; j < n; ++j) c += this->K[t][i * n + j][lane] * (now[j] - x[t][j][lane]);
        own_u[t * m + i] = clipped(c, box[0][i], box[1][i]);
      }
      P::cost(t, now, control, one.q_cost[P::cost_alike[t]], &each);
      cost += each;
      magnitude_ += std::fabs(each);
      if (t < T) P::step(now, control, one.q_step, own_x + (t + 1) * n);
    }
  }

  // the conditions of `attempt`
  void write(int lane, int used, Real promised, Real slope, Real change, Real residual) {
    const long i = problem[lane];
    Real *own_x = to.x + i * (T + 1) * n, *own_u = to.u + i * T * m, magnitude_;
    this->fetch(parameters + i * P::PARAMETERS);
    roll(lane, own_x, own_u, to.cost[i], magnitude_);
    const Real much = NOISE * std::numeric_limits<Real>::epsilon() * (magnitude_ + change);
    const Real enough = op_max(settings.tolerance * magnitude_, much);
    const bool settled = promised <= enough && slope <= std::sqrt(enough) * std::sqrt(magnitude_) && finite(to.cost[i]);
    to.residual[i] = residual;
    to.iterations[i] = used;
    if (settled) to.status[i] = CONVERGED;
  }
};

// solves all problems that it can; the status of the others stays OPEN
template <class P>
void solve_linear_quadratic(long count, long threads, const Real* parameters, const Real* bounds, const Real* state,
                            const Real* guess, const Settings& settings, const Results& to) {
  std::vector<long> numbers(count);
  for (long i = 0; i < count; ++i) numbers[i] = i;
  for (const bool first : {true, false}) {
    const long number = long(numbers.size());
    for_each((number + LANES - 1) / LANES, threads, [&](long group) {
      static thread_local LinearQuadratic<P> lanes;
      lanes.parameters = parameters, lanes.state = state, lanes.guess = guess;
      lanes.settings = settings, lanes.to = to;
      std::memcpy(lanes.box, bounds, sizeof(lanes.box));
      lanes.take(numbers.data() + group * LANES, int(std::min(long(LANES), number - group * LANES)));
      first ? lanes.solve_by_pivoting() : lanes.solve_by_interior();
    });
    std::vector<long> open;
    for (const long i : numbers)
      if (to.status[i] == OPEN) open.push_back(i);
    if (open.empty()) return;
    numbers = open;
  }
}

}  // namespace dmmv
