// Plane sweep of Eq. 1 and Eq. 2 on the CPU: warp, accumulate, variance, in one pass.
//
// No warped volume is ever stored: for one voxel the views' samples live in registers. Features are
// channels-last (height, width, channel) float32, one block a view; the volume is (plane, height,
// width, channel), float32 or bfloat16. Compiled and called by sweep.py; same function and same
// gradients as variance_volume in cost_volume.py, which the tests compare it with.

#include <cmath>
#include <cstdint>
#include <cstring>

namespace {

constexpr int kMaxViews = 16;
constexpr float kMinimumZ = 1e-6f;

struct Problem {
  const float* features;    // view, height, width, channel
  const float* projection;  // view, 12: A row by row, then b; the reference's are not read
  const float* hypotheses;  // plane, height, width with the strides below
  int64_t plane_stride, row_stride, column_stride;
  int views, planes, height, width;
};

// Eight channels at once; read and written at any address.
constexpr int kLanes = 8;
typedef float Lanes __attribute__((vector_size(4 * kLanes), aligned(4), may_alias));
typedef uint32_t Bits __attribute__((vector_size(4 * kLanes)));
typedef uint16_t Halves __attribute__((vector_size(2 * kLanes), aligned(2), may_alias));

inline Lanes load(const float* x) { return *reinterpret_cast<const Lanes*>(x); }
inline Lanes load(const uint16_t* x) {
  const Halves halves = *reinterpret_cast<const Halves*>(x);
  return reinterpret_cast<Lanes>(__builtin_convertvector(halves, Bits) << 16);
}
inline void store(float* target, Lanes x) { *reinterpret_cast<Lanes*>(target) = x; }
inline void store(uint16_t* target, Lanes x) {  // round to nearest even
  Bits bits = reinterpret_cast<Bits>(x);
  bits = (bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16;
  *reinterpret_cast<Halves*>(target) = __builtin_convertvector(bits, Halves);
}

// The arithmetic of kBlock neighbouring pixels of a row goes on side by side, in vector registers.
constexpr int kBlock = 16;

// Four neighbours of each pixel's source position; a corner outside the view has weight zero.
struct Corners {
  float weight[4][kBlock];
  int32_t offset[4][kBlock];  // in pixels
  int32_t is_seen[kBlock];
};

// Without a branch and without && or |, so that compilers vectorise it. A position out of view, and
// one that is not a number, is moved to where all its weights are zero.
inline void locate(const Problem& p, int view, int row, int column, const float* __restrict depth,
                   Corners* __restrict corners) {
  const float* m = p.projection + 12 * view;
  const int last_c = p.width - 1, last_r = p.height - 1;
  const float width = p.width, height = p.height, v = row + 0.5f;
  for (int i = 0; i < kBlock; ++i) {
    const float u = column + i + 0.5f;
    const float z = (m[6] * u + m[7] * v + m[8]) * depth[i] + m[11];
    const float inverse = 1.0f / (z > kMinimumZ ? z : 1.0f);
    float x = ((m[0] * u + m[1] * v + m[2]) * depth[i] + m[9]) * inverse - 0.5f;
    float y = ((m[3] * u + m[4] * v + m[5]) * depth[i] + m[10]) * inverse - 0.5f;
    x = z > kMinimumZ ? x : -1.0f;
    x = x > -1.0f ? x : -1.0f;
    y = y > -1.0f ? y : -1.0f;
    x = x < width ? x : width;
    y = y < height ? y : height;
    const float left = std::floor(x), top = std::floor(y);
    const int c = static_cast<int>(left), r = static_cast<int>(top);
    float left_share = c < 0 ? 0.0f : left + 1 - x, top_share = r < 0 ? 0.0f : top + 1 - y;
    left_share = c > last_c ? 0.0f : left_share;
    top_share = r > last_r ? 0.0f : top_share;
    const float right_share = c < last_c ? x - left : 0.0f;
    const float bottom_share = r < last_r ? y - top : 0.0f;
    const int c0 = c < 0 ? 0 : c > last_c ? last_c : c, c1 = c < last_c ? c + 1 : last_c;
    const int r0 = r < 0 ? 0 : r > last_r ? last_r : r, r1 = r < last_r ? r + 1 : last_r;
    corners->weight[0][i] = top_share * left_share;
    corners->weight[1][i] = top_share * right_share;
    corners->weight[2][i] = bottom_share * left_share;
    corners->weight[3][i] = bottom_share * right_share;
    corners->offset[0][i] = r0 * p.width + c0;
    corners->offset[1][i] = r0 * p.width + c1;
    corners->offset[2][i] = r1 * p.width + c0;
    corners->offset[3][i] = r1 * p.width + c1;
    corners->is_seen[i] = (top_share + bottom_share) * (left_share + right_share) > 0;
  }
}

template <int C>
inline void sample(const float* image, const Corners& at, int i, Lanes* value) {
  const float *a = image + at.offset[0][i] * int64_t{C}, *b = image + at.offset[1][i] * int64_t{C};
  const float *c = image + at.offset[2][i] * int64_t{C}, *d = image + at.offset[3][i] * int64_t{C};
  const float wa = at.weight[0][i], wb = at.weight[1][i];
  const float wc = at.weight[2][i], wd = at.weight[3][i];
  for (int k = 0; k < C / kLanes; ++k, a += kLanes, b += kLanes, c += kLanes, d += kLanes)
    value[k] = wa * load(a) + wb * load(b) + wc * load(c) + wd * load(d);
}

// Calls work(pixel, voxel, i, corners of every view) for each voxel of the rows.
template <typename Work>
void for_each_voxel(const Problem& p, int begin, int end, const Work& work) {
  Corners corners[kMaxViews];
  float depth[kBlock];
  for (int plane = 0; plane < p.planes; ++plane)
    for (int row = begin; row < end; ++row) {
      const float* hypotheses = p.hypotheses + plane * p.plane_stride + row * p.row_stride;
      for (int column = 0; column < p.width; column += kBlock) {
        const int count = p.width - column < kBlock ? p.width - column : kBlock;
        for (int i = 0; i < kBlock; ++i)
          depth[i] = hypotheses[(column + (i < count ? i : count - 1)) * p.column_stride];
        for (int view = 1; view < p.views; ++view)
          locate(p, view, row, column, depth, &corners[view]);
        const int64_t pixel = static_cast<int64_t>(row) * p.width + column;
        const int64_t voxel = static_cast<int64_t>(plane) * p.height * p.width + pixel;
        for (int i = 0; i < count; ++i) work(pixel + i, voxel + i, i, corners);
      }
    }
}

template <int C, typename T>
void forward_rows(const Problem& p, int begin, int end, T* volume) {
  const int64_t image = static_cast<int64_t>(p.height) * p.width * C;
  const float share = 1.0f / p.views;
  for_each_voxel(p, begin, end, [=](int64_t pixel, int64_t voxel, int i, const Corners* at) {
    Lanes sum[C / kLanes], squares[C / kLanes], value[C / kLanes];
    for (int k = 0; k < C / kLanes; ++k) {
      sum[k] = load(p.features + pixel * C + k * kLanes);
      squares[k] = sum[k] * sum[k];
    }
    for (int view = 1; view < p.views; ++view) {
      if (!at[view].is_seen[i]) continue;
      sample<C>(p.features + view * image, at[view], i, value);
      for (int k = 0; k < C / kLanes; ++k) sum[k] += value[k], squares[k] += value[k] * value[k];
    }
    for (int k = 0; k < C / kLanes; ++k) {
      const Lanes mean = sum[k] * share;
      store(volume + voxel * C + k * kLanes, squares[k] * share - mean * mean);
    }
  });
}

// d variance / d V_i = 2 / M (V_i - mean). `gradient` is this thread's own copy.
template <int C, typename T>
void backward_rows(const Problem& p, int begin, int end, const T* volume_gradient,
                   float* gradient) {
  const int64_t image = static_cast<int64_t>(p.height) * p.width * C;
  const float share = 1.0f / p.views;
  for_each_voxel(p, begin, end, [=](int64_t pixel, int64_t voxel, int i, const Corners* at) {
    Lanes mean[C / kLanes], scaled[C / kLanes], value[kMaxViews][C / kLanes];
    for (int k = 0; k < C / kLanes; ++k) mean[k] = load(p.features + pixel * C + k * kLanes);
    for (int view = 1; view < p.views; ++view) {
      if (!at[view].is_seen[i]) continue;
      sample<C>(p.features + view * image, at[view], i, value[view]);
      for (int k = 0; k < C / kLanes; ++k) mean[k] += value[view][k];
    }
    for (int k = 0; k < C / kLanes; ++k) {
      mean[k] *= share;
      scaled[k] = 2.0f * share * load(volume_gradient + voxel * C + k * kLanes);
      float* target = gradient + pixel * C + k * kLanes;
      const Lanes reference = load(p.features + pixel * C + k * kLanes);
      store(target, load(target) + scaled[k] * (reference - mean[k]));
    }
    for (int view = 1; view < p.views; ++view) {
      if (!at[view].is_seen[i]) continue;
      for (int corner = 0; corner < 4; ++corner) {
        const float weight = at[view].weight[corner][i];
        float* into = gradient + view * image + at[view].offset[corner][i] * int64_t{C};
        for (int k = 0; k < C / kLanes; ++k, into += kLanes)
          store(into, load(into) + weight * (scaled[k] * (value[view][k] - mean[k])));
      }
    }
  });
}

template <typename T>
int forward_any(const Problem& p, int channels, int begin, int end, T* volume) {
  switch (channels) {
    case 8: forward_rows<8>(p, begin, end, volume); return 0;
    case 16: forward_rows<16>(p, begin, end, volume); return 0;
    case 32: forward_rows<32>(p, begin, end, volume); return 0;
    default: return 1;
  }
}

template <typename T>
int backward_any(const Problem& p, int channels, int begin, int end, const T* volume_gradient,
                 float* gradient) {
  switch (channels) {
    case 8: backward_rows<8>(p, begin, end, volume_gradient, gradient); return 0;
    case 16: backward_rows<16>(p, begin, end, volume_gradient, gradient); return 0;
    case 32: backward_rows<32>(p, begin, end, volume_gradient, gradient); return 0;
    default: return 1;
  }
}

}  // namespace

extern "C" {

// shape: views, planes, height, width, channels. strides: of the hypotheses, elements.
// Rows [begin, end) of the reference. Returns 1 for a channel count without a kernel.
int sweep_forward(const float* features, const float* projection, const float* hypotheses,
                  const int64_t* strides, const int64_t* shape, int begin, int end,
                  int is_bfloat16, void* volume) {
  const Problem p{features,   projection, hypotheses, strides[0],
                  strides[1], strides[2], (int)shape[0], (int)shape[1],
                  (int)shape[2], (int)shape[3]};
  return is_bfloat16 ? forward_any(p, (int)shape[4], begin, end, static_cast<uint16_t*>(volume))
                     : forward_any(p, (int)shape[4], begin, end, static_cast<float*>(volume));
}

int sweep_backward(const float* features, const float* projection, const float* hypotheses,
                   const int64_t* strides, const int64_t* shape, int begin, int end,
                   int is_bfloat16, const void* volume_gradient, float* gradient) {
  const Problem p{features,   projection, hypotheses, strides[0],
                  strides[1], strides[2], (int)shape[0], (int)shape[1],
                  (int)shape[2], (int)shape[3]};
  return is_bfloat16 ? backward_any(p, (int)shape[4], begin, end,
                                    static_cast<const uint16_t*>(volume_gradient), gradient)
                     : backward_any(p, (int)shape[4], begin, end,
                                    static_cast<const float*>(volume_gradient), gradient);
}
}
