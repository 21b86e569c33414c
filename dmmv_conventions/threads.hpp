// Work of a library shared among threads.
#pragma once
#include <atomic>
#include <system_error>
#include <thread>
#include <vector>
#ifdef __SSE2__
#include <xmmintrin.h>
#endif

namespace dmmv {

// While one lives, numbers too small to be normal count as zero: slopes fade to them step by step, and a processor takes
// a hundred times as long for each.
struct NormalOnly {
#ifdef __SSE2__
  unsigned before = _mm_getcsr();
  NormalOnly() { _mm_setcsr(before | 0x8040); }
  ~NormalOnly() { _mm_setcsr(before); }
#endif
};

// f(i) for all i < count, shared among threads
template <class F>
inline void for_each(long count, long threads, F f) {
  std::atomic<long> next{0};
  auto work = [&] {
    const NormalOnly flushed;
    for (long i = next++; i < count; i = next++) f(i);
  };
  std::vector<std::thread> helpers;
  try {
    for (long k = 1; k < (threads < count ? threads : count); ++k) helpers.emplace_back(work);
  } catch (const std::system_error&) {
    // a machine that has no more threads to give: those that are there do the work
  }
  work();
  for (auto& helper : helpers) helper.join();
}

}  // namespace dmmv
