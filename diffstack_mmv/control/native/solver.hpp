// Control-limited DDP for one problem: the iterations of `ILQR`, number by number.
//
// The generated `Problem` has the sizes n, m, T, and the functions of its stages.
#pragma once
#include <algorithm>
#ifdef DMMV_CLOCK
#include <time.h>
#endif

#include "stage.hpp"

namespace dmmv {

enum Status { OPEN = -1, CONVERGED = DMMV_CONVERGED, LIMIT = DMMV_LIMIT, STALLED = DMMV_STALLED, NOT_FINITE = DMMV_NOT_FINITE, UNBOUNDED = DMMV_UNBOUNDED };
constexpr Real NEAR_ = Real(0.3), NOISE = 8, DAMPING_MAX = Real(1e8), GROWTH = 8, DECAY = Real(0.2), SHARE_MIN = Real(1e-4), SHARE_GROWTH = 4, SHARE_DECAY = Real(0.1), FAR = Real(3e-2), ARRIVED = Real(0.99);
constexpr Real EPSILON = std::numeric_limits<Real>::epsilon();
constexpr int MOST_SIZES = 64, LARGE = 6;

struct Settings {
  int max_iterations;
  int sizes;
  int curvature;  // 0: exact at every iteration, 1: of the dynamics only near the solution
  Real tolerance;
  Real regularisation;
};

// processor seconds in each part of the iterations, for benchmarks, which define DMMV_CLOCK
enum Part { EXPAND, RECURSION, SEARCH, PARTS };
struct Timed {
  Part part;
#ifdef DMMV_CLOCK
  static inline double seconds[PARTS];
  static double now() {
    timespec at;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &at);
    return double(at.tv_sec) + 1e-9 * double(at.tv_nsec);
  }
  double began = now();
  ~Timed() { seconds[part] += now() - began; }
#endif
};

template <class P>
struct Solver {
  static constexpr int n = P::n, m = P::m, T = P::T, S = LANES;

  // numbers of the problem, see `prepare`
  Real numbers[P::NUMBERS + 1], q_step[P::STEP_NUMBERS + 1], q_cost[T + 1][P::COST_NUMBERS + 1];
  Real box[2][m];

  // where the problem stands
  Real x[T + 1][n], u[T + 1][m], cost, damping, share;
  int status, iterations;
  bool near_;

  // local model
  Real A[T][n * n], B[T][n * m], c_x[T + 1][n], c_u[T + 1][m];
  Real H_xx[T + 1][n * n], H_ux[T + 1][m * n], H_uu[T + 1][m * m];
  Real costate[T][n], gradient[T][m], magnitude, noise;

  // policy, and that of the convex model where both are tried
  struct Gains {
    Real k[T][m], K[T][m * n];
  } gains, convex_gains;
  Real decrease, slope;
  bool lifted, lifted_free, either;

  // trial
  Pack all_x[T + 1][n], all_u[T][m];
  struct Path {
    Real x[T + 1][n], u[T][m], cost, size;
  } best;

  void prepare(const Real* parameters, const Real* bounds) {
    P::prelude(parameters, numbers);
    for (int i = 0; i < P::STEP_NUMBERS; ++i) q_step[i] = numbers[P::step_numbers[i]];
    for (int t = 0; t <= T; ++t)
      for (int i = 0; i < P::COST_NUMBERS; ++i) q_cost[t][i] = numbers[P::cost_numbers[t][i]];
    std::memcpy(box, bounds, sizeof(box));
  }

  // what rounding an entry can do to the cost, in units of the precision; as _rounded() of expansion.py
  static Real rounded(Real value, Real slope, Real curvature) {
    return std::fabs(value * slope) + Real(0.5) * EPSILON * value * value * std::fabs(curvature);
  }

  void expand(bool with_curvature) {
    [[maybe_unused]] const Timed timed{EXPAND};
    magnitude = 0;
    Real change = 0;
    for (int i = 0; i < m; ++i) u[T][i] = 0;
    for (int t = 0; t <= T; ++t) {
      const Real c = cost_model<P>(t, x[t], u[t], q_cost[t], c_x[t], c_u[t], H_xx[t], H_ux[t], H_uu[t]);
      magnitude += std::fabs(c);
      for (int i = 0; i < n; ++i) change += rounded(x[t][i], c_x[t][i], H_xx[t][i * n + i]);
      if (t < T)
        for (int i = 0; i < m; ++i) change += rounded(u[t][i], c_u[t][i], H_uu[t][i * m + i]);
    }
    noise = EPSILON * (magnitude + change);
    std::memcpy(costate[T - 1], c_x[T], sizeof(costate[0]));
    for (int t = T - 1; t >= 0; --t) {
      if (with_curvature)
        step_model<P>(x[t], u[t], costate[t], q_step, A[t], B[t], H_xx[t], H_ux[t], H_uu[t]);
      else
        step_jacobian<P>(x[t], u[t], q_step, A[t], B[t]);
      std::memcpy(gradient[t], c_u[t], sizeof(gradient[0]));
      add_transposed_apply<n, m>(B[t], costate[t], gradient[t]);
      if (t == 0) continue;
      std::memcpy(costate[t - 1], c_x[t], sizeof(costate[0]));
      add_transposed_apply<n, n>(A[t], costate[t], costate[t - 1]);
    }
  }

  bool held(int t, int i) const {
    const Real g = gradient[t][i], low = box[0][i], high = box[1][i];
    return (u[t][i] <= low && g > 0) || (u[t][i] >= high && g < 0) || low == high;
  }

  // the exact model, or with a share above zero a convex one
  void backward(Real dominating) {
    const Real infinity = farthest();
    Real V_x[n], V_xx[n * n];
    std::memcpy(V_x, c_x[T], sizeof(V_x));
    std::memcpy(V_xx, H_xx[T], sizeof(V_xx));
    if (dominating > 0) add_dominance<n>(V_xx, nullptr, dominating);
    decrease = slope = 0;
    lifted = lifted_free = false;
    for (int t = T - 1; t >= 0; --t) {
      Real xx[n * n], ux[m * n], uu[m * m], Q_x[n], Q_u[m], VA[n * n], VB[n * m];
      std::memcpy(xx, H_xx[t], sizeof(xx));
      std::memcpy(ux, H_ux[t], sizeof(ux));
      std::memcpy(uu, H_uu[t], sizeof(uu));
      if (dominating > 0) dominate(xx, ux, uu, dominating);
      std::memcpy(Q_x, c_x[t], sizeof(Q_x));
      std::memcpy(Q_u, c_u[t], sizeof(Q_u));
      add_transposed_apply<n, n>(A[t], V_x, Q_x);
      add_transposed_apply<n, m>(B[t], V_x, Q_u);
      product<n, n, n>(V_xx, A[t], VA);
      product<n, n, m>(V_xx, B[t], VB);
      add_transposed_product<n, n, n>(A[t], VA, xx);
      add_transposed_product<n, m, n>(B[t], VA, ux);
      add_transposed_product<n, m, m>(B[t], VB, uu);
      make_symmetric<m>(uu);
      act(t, infinity, uu, ux, Q_u);
      // V_x = Q_x + K'(Q_uu k + Q_u) + Q_ux'k,  V_xx = Q_xx + K'Q_uu K + K'Q_ux + Q_ux'K
      Real Qk[m] = {}, QK[m * n];
      add_product<m, m>(uu, gains.k[t], Qk);
      product<m, m, n>(uu, gains.K[t], QK);
      for (int i = 0; i < m; ++i) {
        decrease -= gains.k[t][i] * (Real(0.5) * Qk[i] + Q_u[i]);
        Qk[i] += Q_u[i];
      }
      for (int i = 0; i < m * n; ++i) QK[i] += ux[i];
      std::memcpy(V_x, Q_x, sizeof(V_x));
      add_transposed_apply<m, n>(gains.K[t], Qk, V_x);
      add_transposed_apply<m, n>(ux, gains.k[t], V_x);
      std::memcpy(V_xx, xx, sizeof(V_xx));
      add_transposed_product<m, n, n>(gains.K[t], QK, V_xx);
      add_transposed_product<m, n, n>(ux, gains.K[t], V_xx);
      make_symmetric<n>(V_xx);
    }
  }

  void dominate(Real* xx, const Real* ux, Real* uu, Real dominating) const {
    Real beside_x[n] = {}, beside_u[m] = {};
    for (int i = 0; i < m; ++i)
      for (int j = 0; j < n; ++j) {
        beside_x[j] += std::fabs(ux[i * n + j]);
        beside_u[i] += std::fabs(ux[i * n + j]);
      }
    add_dominance<n>(xx, beside_x, dominating);
    add_dominance<m>(uu, beside_u, dominating);
  }

  // k and K of one time; damps and lifts Q_uu
  void act(int t, Real infinity, Real* uu, const Real* ux, const Real* Q_u) {
    Real parted[m * m], lift[m], low[m], high[m], inverse[m * m], product_[m * n];
    bool is_free[m];
    for (int i = 0; i < m; ++i)
      for (int j = 0; j < m; ++j)
        parted[i * m + j] = i != j && (held(t, i) || held(t, j)) ? Real(0) : uu[i * m + j];
    positive_lift<m>(parted, lift);
    const Real weight = damping * largest<m>(uu);
    for (int i = 0; i < m; ++i) {
      const Real curvature = uu[i * m + i] + lift[i];
      uu[i * m + i] = uu[i * m + i] + (lift[i] + weight);
      low[i] = clipped(box[0][i], -infinity, infinity) - u[t][i];
      high[i] = clipped(box[1][i], -infinity, infinity) - u[t][i];
      slope -= gradient[t][i] * clipped(-gradient[t][i] / curvature, low[i], high[i]);
      if (held(t, i)) low[i] = high[i] = 0;
    }
    solve_box_qp<m>(uu, Q_u, low, high, gains.k[t], is_free);
    if (m < 3 || !definite_inverse<m>(uu, is_free, inverse)) free_inverse<m>(uu, is_free, inverse);
    product<m, m, n>(inverse, ux, product_);
    for (int i = 0; i < m * n; ++i) gains.K[t][i] = -product_[i];
    for (int i = 0; i < m; ++i) {
      lifted = lifted || lift[i] > 0;
      lifted_free = lifted_free || (lift[i] > 0 && is_free[i]);
    }
  }

  // as definite_policies() of definite.py
  void policy() {
    [[maybe_unused]] const Timed timed{RECURSION};
    backward(0);
    either = false;
    if (!lifted_free && !(lifted && decrease > FAR * magnitude)) return;
    const Gains exact = gains;
    // over long horizons the indefinite recursion may overflow: then it promises all there is
    const bool usable = finite(decrease) && finite(slope);
    const Real promised = usable ? decrease : magnitude, exact_slope = slope;
    backward(share);
    // one that is lifted by a share alone may too: its step is refused, and the next one is lifted by all
    if (share < 1 && !(finite(decrease) && finite(slope))) {
      decrease = magnitude;
      slope = 0;
    }
    either = usable && !(decrease > FAR * magnitude);
    if (either) {
      convex_gains = gains;
      gains = exact;
    } else {
      share = 1;
    }
    decrease = op_max(promised, decrease);
    if (usable) slope = op_max(exact_slope, slope);
  }

  // all step sizes 1, 1/2, 1/4, ... at once; the longest of those that the noise cannot tell apart
  void search(int sizes, Real noise_) {
    [[maybe_unused]] const Timed timed{SEARCH};
    Real costs[MOST_SIZES], least = INFINITY;
    for (int first = 0; first < sizes; first += S) {
      roll(first, std::min(S, sizes - first), costs + first);
      for (int s = first; s < std::min(first + S, sizes); ++s) least = std::min(least, costs[s]);
    }
    int chosen = 0;
    while (costs[chosen] > least + noise_) ++chosen;  // noise that is no number tells nothing apart: the first one
    if (sizes > S) roll(chosen / S * S, S, nullptr);
    const int lane = chosen % S;
    for (int t = 0; t <= T; ++t)
      for (int i = 0; i < n; ++i) best.x[t][i] = all_x[t][i][lane];
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) best.u[t][i] = all_u[t][i][lane];
    best.cost = costs[chosen];
    best.size = std::ldexp(Real(1), -chosen);
  }

  void roll(int first, int count, Real* costs) {
    Pack size, each, total = {}, nothing[m] = {}, state[n], control[m];
    for (int s = 0; s < S; ++s) size[s] = std::ldexp(Real(1), -(first + s));
    for (int i = 0; i < n; ++i) state[i] = all_x[0][i] = Pack{} + x[0][i];
    for (int t = 0; t < T; ++t) {
      for (int i = 0; i < m; ++i) {
        Pack c = u[t][i] + size * gains.k[t][i], change = {};
        for (int j = 0; j < n; ++j) change += gains.K[t][i * n + j] * (state[j] - x[t][j]);
        c += change;
        const Pack low = Pack{} + box[0][i], high = Pack{} + box[1][i];
        c = c < low ? low : c;
        control[i] = all_u[t][i] = c > high ? high : c;
      }
      P::cost(t, state, control, q_cost[t], &each);
      total += each;
      P::step(state, control, q_step, all_x[t + 1]);
      for (int i = 0; i < n; ++i) state[i] = all_x[t + 1][i];
    }
    P::cost(T, state, nothing, q_cost[T], &each);
    total += each;
    if (costs)
      for (int s = 0; s < count; ++s) costs[s] = finite(total[s]) ? total[s] : Real(INFINITY);
  }

  void accept() {
    std::memcpy(x, best.x, sizeof(x));
    std::memcpy(u, best.u, sizeof(best.u));
    cost = best.cost;
  }

  // as attempt() and cheaper() of iteration.py
  void attempt(const Settings& settings) {
    const Real much = NOISE * noise;
    search(settings.sizes, much);
    if (either) {
      const Path exact = best;
      gains = convex_gains;
      search(settings.sizes, much);
      if (!(best.cost < cost && best.cost < exact.cost)) best = exact;
    }
    const Real enough = op_max(settings.tolerance * magnitude, much);
    const bool lower = best.cost < cost;
    bool flat = decrease <= enough && damping < 1;
    flat = flat || (!lower && decrease <= NOISE * much);
    const bool settled = flat && slope <= std::sqrt(enough) * std::sqrt(magnitude);
    const bool accepted = lower || (flat && best.cost <= cost + much);
    if (accepted) {
      damping = best.size >= Real(0.5) ? damping * DECAY : damping;
      if (damping < Real(0.1) * settings.regularisation) damping = 0;
      accept();
    } else {
      damping = std::max(damping * GROWTH, settings.regularisation);
    }
    const bool is_long = accepted && best.size >= Real(0.5);
    share = is_long ? op_max(share * SHARE_DECAY, n < LARGE ? Real(1) : SHARE_MIN) : op_min(share * SHARE_GROWTH, Real(1));
    if (damping > DAMPING_MAX) status = STALLED;
    if (settled) status = CONVERGED;
    if (!finite(decrease) || noise != noise) status = NOT_FINITE;
    ++iterations;
    near_ = decrease <= NEAR_ * magnitude;
  }

  void start(const Real* state, const Real* controls) {
    std::memcpy(x[0], state, sizeof(x[0]));
    std::memcpy(u, controls, sizeof(best.u));
    for (int t = 1; t <= T; ++t) std::memcpy(x[t], state, sizeof(x[0]));
    gains = {};
    either = false;
    cost = INFINITY;
    damping = 0;
    share = 1;
    iterations = 0;
    near_ = false;
    search(1, 0);
    if (best.cost < cost) accept();
    bool is_finite = finite(cost);
    for (int t = 0; t <= T; ++t)
      for (int i = 0; i < n; ++i) is_finite = is_finite && finite(x[t][i]);
    status = is_finite ? OPEN : NOT_FINITE;
  }

  void solve(const Real* state, const Real* controls, const Settings& settings) {
    start(state, controls);
    while (iterations < settings.max_iterations && status == OPEN) {
      expand(settings.curvature == 0 || near_);
      policy();
      attempt(settings);
    }
    if (status == OPEN) status = LIMIT;
    if (iterations > 0 && ran_off()) status = UNBOUNDED;
  }

  // what stands for an infinite bound
  static Real farthest() { return std::sqrt(std::sqrt(std::numeric_limits<Real>::max())); }

  // as concluded() of iteration.py
  bool ran_off() const {
    bool far = cost <= -farthest() * farthest();
    for (int t = 0; t < T; ++t)
      for (const Real control : u[t]) far = far || std::fabs(control) >= ARRIVED * farthest();
    return far;
  }

  // projected gradient at the end; nothing of a problem is NaN any more
  Real conclude() {
    for (auto& row : x)
      for (Real& entry : row) entry = plain(entry);
    for (auto& row : u)
      for (Real& entry : row) entry = plain(entry);
    expand(false);
    Real residual = 0;
    for (int t = 0; t < T; ++t)
      for (int i = 0; i < m; ++i) {
        const Real moved = clipped(u[t][i] - gradient[t][i], box[0][i], box[1][i]);
        const Real off = std::fabs(u[t][i] - moved);
        residual = off != off ? Real(INFINITY) : std::max(residual, off);
      }
    return residual;
  }

  static Real plain(Real a) {
    const Real most = std::numeric_limits<Real>::max();
    return a != a ? Real(0) : clipped(a, -most, most);
  }
};

}  // namespace dmmv
