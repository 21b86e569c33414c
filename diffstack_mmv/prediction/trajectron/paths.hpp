// Scores of Gaussian mixtures of paths, many rows: log densities of the truth and the energy score of the means, and
// their slopes. The times of a path stand side by side in vectors.
#pragma once
#include "lanes.hpp"

namespace {

constexpr Real TINY = Real(1e-12);  // m², as in safe_norm

inline V root(V square) {
  for (int lane = 0; lane < LANES; ++lane) square[lane] = std::sqrt(square[lane]);
  return square;
}

// the truth and the components of one row
struct Paths {
  long K, T, width = vectors(T);
  Real floor;
  Rows valid = Rows(width), truth = Rows(2 * width), mean = Rows(2 * K * width), covariance = Rows(3 * K * width);
  Real count = 0;

  // numbers `unit` of T times, `stride` apart
  void take(const Real* from, long stride, V* to) const {
    Real* entries = reinterpret_cast<Real*>(to);
    for (long t = 0; t < T; ++t) entries[t] = from[t * stride];
  }
  void read(const Real* valid_, const Real* truth_, const Real* mean_, const Real* covariance_) {
    take(valid_, 1, valid.data());
    count = 0;
    for (long t = 0; t < T; ++t) count += valid_[t];
    count = std::max(count, Real(1));
    for (int i = 0; i < 2; ++i) take(truth_ + i, 2, &truth[i * width]);
    for (long k = 0; k < K; ++k) {
      for (int i = 0; i < 2; ++i) take(mean_ + k * T * 2 + i, 2, &mean[(2 * k + i) * width]);
      const int entry[] = {0, 2, 3};
      for (int i = 0; i < 3; ++i) take(covariance_ + k * T * 4 + entry[i], 4, &covariance[(3 * k + i) * width]);
    }
  }

  // what a density needs at one vector of times: error, first variance, covariance, whitened second error and variance
  struct Gaussian {
    V e, f, a, b, r, s, rest;
  };
  Gaussian gaussian(long k, long v) const {
    Gaussian g;
    g.e = truth[v] - mean[2 * k * width + v];
    g.f = truth[width + v] - mean[(2 * k + 1) * width + v];
    g.a = covariance[3 * k * width + v] + floor;
    g.b = covariance[(3 * k + 1) * width + v];
    g.rest = covariance[(3 * k + 2) * width + v] + floor - g.b * g.b / g.a;
    g.s = g.rest < Real(0.5) * floor ? V{} + Real(0.5) * floor : g.rest;
    g.r = g.f - g.b * g.e / g.a;
    return g;
  }
  Real log_density(long k) const {
    V sum = V{};
    for (long v = 0; v < width; ++v) {
      const Gaussian g = gaussian(k, v);
      V log = g.a * g.s;
      for (int lane = 0; lane < LANES; ++lane) log[lane] = valid[v][lane] != 0 ? std::log(log[lane]) : Real(0);
      const V each = Real(-0.5) * (g.e * g.e / g.a + g.r * g.r / g.s + log) - Real(1.8378770664093453);
      sum += valid[v] != V{} ? each : V{};
    }
    return total(sum);
  }
  // slopes of the log density times g are added to those of mean (2, width), and written to those of covariance (3, width)
  void density_slopes(long k, Real weight, V* by_mean, V* by_covariance) const {
    for (long v = 0; v < width; ++v) {
      const Gaussian g = gaussian(k, v);
      const V own = valid[v] * weight, x = g.e / g.a, y = g.r / g.s, z = g.b / g.a;
      const V by_s = g.rest < Real(0.5) * floor ? V{} : Real(0.5) * (y * y - 1 / g.s);
      by_mean[v] += valid[v] != V{} ? own * (x - y * z) : V{};
      by_mean[width + v] += valid[v] != V{} ? own * y : V{};
      const V by_a = Real(0.5) * (x * x - 1 / g.a) - y * z * x + by_s * z * z;
      by_covariance[v] = valid[v] != V{} ? own * by_a : V{};
      by_covariance[width + v] = valid[v] != V{} ? own * (y * x - 2 * by_s * z) : V{};
      by_covariance[2 * width + v] = valid[v] != V{} ? own * by_s : V{};
    }
  }

  // difference of the path of a component and that of another, or the truth, and its length
  struct Apart {
    V x, y, length;
  };
  Apart apart(long k, const V* other, long v) const {
    Apart d{mean[2 * k * width + v] - other[v], mean[(2 * k + 1) * width + v] - other[width + v], V{}};
    d.length = root(d.x * d.x + d.y * d.y + TINY);
    return d;
  }
  Real energy(const Real* weight) const {
    V sum = V{};
    for (long v = 0; v < width; ++v) {
      V each = V{};
      for (long k = 0; k < K; ++k) {
        each += weight[k] * apart(k, truth.data(), v).length;
        for (long l = 0; l < k; ++l) each -= weight[k] * weight[l] * apart(k, &mean[2 * l * width], v).length;
      }
      sum += valid[v] != V{} ? each : V{};
    }
    return total(sum) / count;
  }
  // slopes of the energy times g, those of means with less than a share left out
  void energy_slopes(const Real* weight, Real share, Real g, V* by_mean, Real* by_weight) const {
    auto pull = [&](long k, long v, V toward, V across) {
      if (weight[k] < share) return;
      by_mean[2 * k * width + v] += toward;
      by_mean[(2 * k + 1) * width + v] += across;
    };
    for (long v = 0; v < width; ++v) {
      const V own = valid[v] * (g / count);
      for (long k = 0; k < K; ++k) {
        const Apart missed = apart(k, truth.data(), v);
        const V pulled = own * weight[k] / missed.length;
        by_weight[k] += total(own * missed.length);
        pull(k, v, pulled * missed.x, pulled * missed.y);
        for (long l = 0; l < k; ++l) {
          const Apart d = apart(k, &mean[2 * l * width], v);
          const V pushed = own * (weight[k] * weight[l]) / d.length;
          const Real length = total(own * d.length);
          by_weight[k] -= weight[l] * length;
          by_weight[l] -= weight[k] * length;
          pull(k, v, -pushed * d.x, -pushed * d.y);
          pull(l, v, pushed * d.x, pushed * d.y);
        }
      }
    }
  }
};

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// valid (rows, T) 1 or 0, truth (rows, T, 2), mean (rows, K, T, 2), covariance (rows, K, T, 2, 2), weight (rows, K), where
// the energy is asked for -> log density of the path (rows, K), energy score (rows). `known` are the floor of variances
// and the share from which a component's mean has a slope.
void dmmv_paths(long rows, long threads, long K, long T, const Real* known, const Real* valid, const Real* truth,
                const Real* mean, const Real* covariance, const Real* weight, Real* log_density, Real* energy) {
  each_block(rows, threads, [=](Block block) {
    Paths paths{K, T, vectors(T), known[0]};
    for (long row = block.first; row < block.first + block.count; ++row) {
      paths.read(valid + row * T, truth + row * T * 2, mean + row * K * T * 2, covariance + row * K * T * 4);
      for (long k = 0; k < K; ++k) log_density[row * K + k] = paths.log_density(k);
      energy[row] = weight ? paths.energy(weight + row * K) : Real(0);
    }
  });
}

// Gradients for those in log densities and energy.
void dmmv_paths_adjoint(long rows, long threads, long K, long T, const Real* known, const Real* valid, const Real* truth,
                        const Real* mean, const Real* covariance, const Real* weight, const Real* g_log_density,
                        const Real* g_energy, Real* g_mean, Real* g_covariance, Real* g_weight) {
  each_block(rows, threads, [=](Block block) {
    Paths paths{K, T, vectors(T), known[0]};
    const long width = paths.width;
    Rows by_mean(2 * K * width), by_covariance(3 * width);
    for (long row = block.first; row < block.first + block.count; ++row) {
      paths.read(valid + row * T, truth + row * T * 2, mean + row * K * T * 2, covariance + row * K * T * 4);
      std::fill(by_mean.begin(), by_mean.end(), V{});
      if (weight) {
        std::fill_n(g_weight + row * K, K, Real(0));
        paths.energy_slopes(weight + row * K, known[1], g_energy[row], by_mean.data(), g_weight + row * K);
      }
      for (long k = 0; k < K; ++k) {
        V* own = &by_mean[2 * k * width];
        const bool seen = g_log_density[row * K + k] != 0;
        if (seen) paths.density_slopes(k, g_log_density[row * K + k], own, by_covariance.data());
        const Real *x = reinterpret_cast<const Real*>(own), *c = reinterpret_cast<const Real*>(by_covariance.data());
        const long step = width * LANES, first = (row * K + k) * T;
        for (long t = 0; t < T; ++t) {
          for (int i = 0; i < 2; ++i) g_mean[(first + t) * 2 + i] = x[i * step + t];
          Real* to = g_covariance + (first + t) * 4;
          to[0] = seen ? c[t] : 0, to[1] = 0, to[2] = seen ? c[step + t] : 0, to[3] = seen ? c[2 * step + t] : 0;
        }
      }
    }
  });
}

}  // extern "C"
#pragma GCC visibility pop
