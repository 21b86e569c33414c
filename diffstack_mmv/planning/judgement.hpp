// How clear plans are of agents: clearance.py number by number, many plans abreast, to rounding.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

namespace judgement {

constexpr int LANES = 16;

// of a ClearanceMargin, as MARGIN_FIELDS names them
struct Settings {
  double MARGIN_FIELDS, dt_s;
};

// e^x for x <= 0; the generic one for other types than float
template <class Real>
inline Real decay(Real x) {
  return std::exp(x);
}
template <>
inline float decay<float>(float x) {
  x = x < -80.0f ? -80.0f : x;
  const float scaled = x * 1.44269504f;
  const float whole = static_cast<float>(static_cast<int>(scaled - 0.5f));
  const float part = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
  float sum = 1.9875691500e-4f;
  sum = sum * part + 1.3981999507e-3f;
  sum = sum * part + 8.3334519073e-3f;
  sum = sum * part + 4.1665795894e-2f;
  sum = sum * part + 1.6666665459e-1f;
  sum = sum * part + 5.0000001201e-1f;
  sum = sum * part * part + part + 1.0f;
  const std::int32_t bits = (static_cast<std::int32_t>(whole) + 127) << 23;
  float power;
  std::memcpy(&power, &bits, sizeof(power));
  return sum * power;
}

// What is asked beside one component of an agent in one step
template <class Real>
struct Asked {
  Real x, y, later_x, later_y;  // of the agent at both ends of the step
  Real hard, comfort;           // margins in m
  Real lateness;                // 1 / (1 + t), zero where nothing is refused
  Real certain, sharpness;      // of the contact: certain * exp(-sharpness * c * c)
  Real turned, wide;            // the same of who has turned off
  Real radius, weight;
};

template <class Real>
void ask(const Settings& s, int steps, const Real* position, Real radius, Real weight, std::vector<Asked<Real>>& asked) {
  Real gone = 0;
  for (int t = 0; t < steps; ++t, position += 2) {
    const Real dx = position[2] - position[0], dy = position[3] - position[1], time = Real(s.dt_s) * Real(t + 1);
    gone += std::sqrt(dx * dx + dy * dy);
    const Real way = std::min(gone, Real(s.saturation_m)), deviation = Real(s.spread_growth) * gone;
    const Real variance = std::max(deviation * deviation, Real(1e-4)), reach = Real(s.reach_m * s.reach_m);
    const Real astray = Real(s.turn_growth) * gone, vague = std::max(astray * astray, Real(1e-4));
    const Real turned = Real(-std::expm1(-s.turn_rate * time));
    const bool counts = time <= Real(s.horizon_s + 1e-6) && weight >= Real(s.probability_min);
    asked.push_back({position[0], position[1], position[2], position[3], Real(s.hard_m) + Real(s.hard_growth) * way,
                     Real(s.comfort_m) + Real(s.comfort_growth) * way, counts ? 1 / (1 + time) : Real(0),
                     (1 - turned) * reach / (reach + 2 * variance), Real(0.5) / variance, turned * reach / (reach + 2 * vague), Real(0.5) / vague,
                     radius, weight});
  }
}

template <class Real>
struct Judged {
  Real penalty[LANES], shortfall[LANES], risk[LANES];
};

// One step of LANES plans beside one component; centres are x of all lanes, then y, step after step
template <class Real>
inline void judge(const Asked<Real>& a, const Real* __restrict centre, int discs, long stride, const Real* __restrict reach, const Real* __restrict live,
                  Real t, Judged<Real>& judged) {
  Real clearance[LANES];
  for (int l = 0; l < LANES; ++l) clearance[l] = Real(1e6);
  for (int d = 0; d < discs; ++d, centre += stride) {
    const Real limit = reach[d] + a.radius;
    for (int l = 0; l < LANES; ++l) {
      const Real sx = a.x - centre[l], sy = a.y - centre[LANES + l];
      const Real dx = (a.later_x - centre[2 * LANES + l]) - sx, dy = (a.later_y - centre[3 * LANES + l]) - sy;
      const Real square = std::max(dx * dx + dy * dy, std::numeric_limits<Real>::min());
      Real along = -(sx * dx + sy * dy) / square;
      along = along < 0 ? Real(0) : along > 1 ? Real(1) : along;
      const Real x = sx + along * dx, y = sy + along * dy;
      const Real found = std::sqrt(x * x + y * y) - limit;
      // what is no number is passed on, of whichever disc
      const bool nearer = found < clearance[l] || found != found;
      clearance[l] = nearer ? found : clearance[l];
    }
  }
  for (int l = 0; l < LANES; ++l) {
    const Real c = t < live[l] ? clearance[l] : Real(1e6);  // who has arrived meets nobody any more
    Real lack = a.hard - c, comfort = a.comfort - c;
    lack = (lack < 0 ? Real(0) : lack) * a.lateness;
    comfort = comfort < 0 ? Real(0) : comfort;
    const Real apart = c < 0 ? Real(0) : c;
    judged.shortfall[l] = lack > judged.shortfall[l] ? lack : judged.shortfall[l];
    judged.penalty[l] += a.weight * comfort * comfort;
    judged.risk[l] += a.weight * a.certain * decay<Real>(-a.sharpness * apart * apart);
    if (a.turned > 0) judged.risk[l] += a.weight * a.turned * decay<Real>(-a.wide * apart * apart);
  }
}

template <class Real>
void centres(int steps, int discs, long plans, const Real* position, const Real* heading, const Real* ahead, Real* out) {
  for (int d = 0; d < discs; ++d)
    for (int t = 0; t <= steps; ++t, out += 2 * LANES)
      for (int l = 0; l < LANES; ++l) {
        const long at = std::min<long>(l, plans - 1) * (steps + 1) + t;
        out[l] = position[2 * at] + (ahead[d] == 0 ? Real(0) : ahead[d] * std::cos(heading[at]));
        out[LANES + l] = position[2 * at + 1] + (ahead[d] == 0 ? Real(0) : ahead[d] * std::sin(heading[at]));
      }
}

// position (problems, plans, steps + 1, 2), live (problems, plans): in how many steps a plan meets anybody;
// agents (problems, count, components, steps + 1, 2); told (problems, plans, 3): penalty, shortfall, risk
template <class Real>
void all(long problems, long plans, int steps, int discs, int count, int components, const Settings& s, const Real* position, const Real* heading,
         const Real* live, const Real* ahead, const Real* reach, const Real* agents, const Real* weight, const Real* radius, const bool* valid, Real* told) {
  const long row = 2 * (steps + 1), stride = (steps + 1) * 2 * LANES;
  std::vector<Asked<Real>> asked;
  std::vector<Real> centre(discs * stride);
  for (long p = 0; p < problems; ++p, ahead += discs, reach += discs) {
    asked.clear();
    for (int n = 0; n < count; ++n)
      for (int k = 0; k < components; ++k) {
        const long at = (p * count + n) * components + k;
        if (valid[p * count + n] && weight[at] > 0) ask(s, steps, agents + at * row, radius[p * count + n], weight[at], asked);
      }
    for (long first = 0; first < plans; first += LANES) {
      const long here = std::min<long>(LANES, plans - first), at = p * plans + first;
      centres(steps, discs, here, position + at * row, heading + at * (steps + 1), ahead, centre.data());
      Judged<Real> judged{};
      Real alive[LANES] = {};
      std::copy(live + at, live + at + here, alive);
      for (std::size_t i = 0; i < asked.size(); ++i) {
        const int t = i % steps;
        judge(asked[i], centre.data() + t * 2 * LANES, discs, stride, reach, alive, Real(t), judged);
      }
      for (long l = 0; l < here; ++l) {
        Real* own = told + 3 * (at + l);
        own[0] = judged.penalty[l] * Real(s.dt_s), own[1] = judged.shortfall[l], own[2] = judged.risk[l] * Real(s.dt_s);
      }
    }
  }
}

}  // namespace judgement

#define JUDGE(NAME, REAL)                                                                                                                            \
  extern "C" __attribute__((visibility("default"))) void judge_##NAME(                                                                               \
      long problems, long plans, int steps, int discs, int count, int components, const judgement::Settings* s, const REAL* position,                \
      const REAL* heading, const REAL* live, const REAL* ahead, const REAL* reach, const REAL* agents, const REAL* weight, const REAL* radius,       \
      const bool* valid, REAL* told) {                                                                                                               \
    judgement::all<REAL>(problems, plans, steps, discs, count, components, *s, position, heading, live, ahead, reach, agents, weight, radius, valid, \
                         told);                                                                                                                      \
  }
JUDGE(float, float)
JUDGE(double, double)
