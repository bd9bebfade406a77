// Gradient of a convolution's weights on the CPU: 3x3 or 3x3x3 taps, stride 1 or 2, padding 1.
//
// oneDNN has no kernel for it with AVX2 and writes out the products of a matrix instead
// (docs/log.md). Volumes are channels-last float32. With stride 1 both are of one size; with
// stride 2 `fine` has twice the columns of `coarse`. For a convolution `fine` is its input and
// `coarse` the gradient of its output; for a transposed one the other way round. Compiled and
// called by convolution_gradient.py.

#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int kLanes = 8;  // coarse channels at once
constexpr int kBlock = 4;  // fine channels at once: 4 x 3 sums stay in vector registers
typedef float Lanes __attribute__((vector_size(4 * kLanes), aligned(4), may_alias));

inline Lanes load(const float* x) { return *reinterpret_cast<const Lanes*>(x); }
inline void store(float* target, Lanes x) { *reinterpret_cast<Lanes*>(target) = x; }

// Adds one row's share to the three taps of a row of the kernel, for kBlock fine channels:
// tap k of column w sees fine column S * w + k - 1. `coarse` has a zero before and after the row.
template <int S>
inline void add_row(const float* fine, int64_t channels, const float* coarse, int columns,
                    float* sums) {
  Lanes sum[kBlock][3];
  for (int i = 0; i < kBlock; ++i)
    for (int k = 0; k < 3; ++k) sum[i][k] = load(sums + (3 * i + k) * kLanes);
  for (int w = 0; w < columns; ++w, fine += S * channels, coarse += kLanes) {
    const Lanes at = load(coarse), after = load(coarse + kLanes);
    if (S == 1) {
      const Lanes before = load(coarse - kLanes);
      for (int i = 0; i < kBlock; ++i) {
        sum[i][0] += fine[i] * after;
        sum[i][1] += fine[i] * at;
        sum[i][2] += fine[i] * before;
      }
    } else {
      for (int i = 0; i < kBlock; ++i) {
        sum[i][0] += fine[channels + i] * after;
        sum[i][1] += fine[i] * at;
        sum[i][2] += fine[channels + i] * at;
      }
    }
  }
  for (int i = 0; i < kBlock; ++i)
    for (int k = 0; k < 3; ++k) store(sums + (3 * i + k) * kLanes, sum[i][k]);
}

struct Size {
  int64_t planes, rows, columns, channels;
};

template <int S>
void add_rows(const float* fine, const Size& f, const float* coarse, const Size& c, int depth,
              int64_t begin, int64_t end, float* gradient) {
  std::vector<float> padded((c.columns + 2) * kLanes);
  for (int64_t row = begin; row < end; ++row) {
    const int64_t h = row % c.rows, d = row / c.rows % c.planes, item = row / c.rows / c.planes;
    float* sums = gradient;
    for (int64_t lane = 0; lane < c.channels; lane += kLanes) {
      for (int64_t w = 0; w < c.columns; ++w)
        store(&padded[(w + 1) * kLanes], load(coarse + (row * c.columns + w) * c.channels + lane));
      for (int kd = 0; kd < depth; ++kd)
        for (int kh = 0; kh < 3; ++kh, sums += f.channels * 3 * kLanes) {
          const int64_t plane = S * d + kd - depth / 2, at = S * h + kh - 1;
          if (plane < 0 || plane >= f.planes || at < 0 || at >= f.rows) continue;
          const float* line =
              fine + ((item * f.planes + plane) * f.rows + at) * f.columns * f.channels;
          for (int64_t i = 0; i < f.channels; i += kBlock)
            add_row<S>(line + i, f.channels, &padded[kLanes], c.columns, sums + 3 * kLanes * i);
        }
    }
  }
}

}  // namespace

extern "C" {

// sizes: planes, rows, columns, channels of fine, then of coarse. depth: the kernel's planes.
// Rows [begin, end) of coarse, counted through planes and items, are added to `gradient`:
// (coarse channels / 8, depth, 3, fine channels, 3, 8).
void weight_gradient(const float* fine, const float* coarse, const int64_t* sizes, int depth,
                     int stride, int64_t begin, int64_t end, float* gradient) {
  const Size f{sizes[0], sizes[1], sizes[2], sizes[3]}, c{sizes[4], sizes[5], sizes[6], sizes[7]};
  if (stride == 1)
    add_rows<1>(fine, f, coarse, c, depth, begin, end, gradient);
  else
    add_rows<2>(fine, f, coarse, c, depth, begin, end, gradient);
}
}
