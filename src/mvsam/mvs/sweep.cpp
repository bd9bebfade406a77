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

// Four neighbours of a source position; a corner outside the view has weight zero.
struct Corners {
  int64_t offset[4];
  float weight[4];
};

inline float as_float(float x) { return x; }
inline float as_float(uint16_t x) {
  uint32_t bits = static_cast<uint32_t>(x) << 16;
  float value;
  std::memcpy(&value, &bits, 4);
  return value;
}
inline void store(float* target, float x) { *target = x; }
inline void store(uint16_t* target, float x) {  // round to nearest even
  uint32_t bits;
  std::memcpy(&bits, &x, 4);
  *target = static_cast<uint16_t>((bits + 0x7fffu + ((bits >> 16) & 1u)) >> 16);
}

template <int C>
inline bool locate(const Problem& p, int view, float u, float v, float depth, Corners* corners) {
  const float* m = p.projection + 12 * view;
  const float z = (m[6] * u + m[7] * v + m[8]) * depth + m[11];
  if (!(z > kMinimumZ)) return false;
  const float inverse = 1.0f / z;
  const float x = ((m[0] * u + m[1] * v + m[2]) * depth + m[9]) * inverse - 0.5f;
  const float y = ((m[3] * u + m[4] * v + m[5]) * depth + m[10]) * inverse - 0.5f;
  if (!(x > -1.0f && y > -1.0f && x < p.width && y < p.height)) return false;
  const float left = std::floor(x), top = std::floor(y);
  const float right_share = x - left, bottom_share = y - top;
  const int column = static_cast<int>(left), row = static_cast<int>(top);
  for (int corner = 0; corner < 4; ++corner) {
    const int dy = corner >> 1, dx = corner & 1;
    const int r = row + dy, c = column + dx;
    const bool inside = r >= 0 && r < p.height && c >= 0 && c < p.width;
    const float weight = (dy ? bottom_share : 1 - bottom_share) * (dx ? right_share : 1 - right_share);
    corners->weight[corner] = inside ? weight : 0.0f;
    corners->offset[corner] = inside ? (static_cast<int64_t>(r) * p.width + c) * C : 0;
  }
  return true;
}

template <int C>
inline void sample(const float* image, const Corners& at, float* value) {
  const float *a = image + at.offset[0], *b = image + at.offset[1];
  const float *c = image + at.offset[2], *d = image + at.offset[3];
  const float wa = at.weight[0], wb = at.weight[1], wc = at.weight[2], wd = at.weight[3];
  for (int k = 0; k < C; ++k) value[k] = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k];
}

template <int C, typename T>
void forward_rows(const Problem& p, int begin, int end, T* volume) {
  const int64_t image = static_cast<int64_t>(p.height) * p.width * C;
  const float share = 1.0f / p.views;
  for (int plane = 0; plane < p.planes; ++plane)
    for (int row = begin; row < end; ++row)
      for (int column = 0; column < p.width; ++column) {
        const int64_t pixel = static_cast<int64_t>(row) * p.width + column;
        const float depth = p.hypotheses[plane * p.plane_stride + row * p.row_stride +
                                         column * p.column_stride];
        const float* reference = p.features + pixel * C;
        float sum[C], squares[C], value[C];
        for (int k = 0; k < C; ++k) sum[k] = reference[k], squares[k] = reference[k] * reference[k];
        for (int view = 1; view < p.views; ++view) {
          Corners at;
          if (!locate<C>(p, view, column + 0.5f, row + 0.5f, depth, &at)) continue;
          sample<C>(p.features + view * image, at, value);
          for (int k = 0; k < C; ++k) sum[k] += value[k], squares[k] += value[k] * value[k];
        }
        T* out = volume + (static_cast<int64_t>(plane) * p.height * p.width + pixel) * C;
        for (int k = 0; k < C; ++k) {
          const float mean = sum[k] * share;
          store(out + k, squares[k] * share - mean * mean);
        }
      }
}

// d variance / d V_i = 2 / M (V_i - mean). `gradient` is this thread's own copy.
template <int C, typename T>
void backward_rows(const Problem& p, int begin, int end, const T* volume_gradient,
                   float* gradient) {
  const int64_t image = static_cast<int64_t>(p.height) * p.width * C;
  const float share = 1.0f / p.views;
  for (int plane = 0; plane < p.planes; ++plane)
    for (int row = begin; row < end; ++row)
      for (int column = 0; column < p.width; ++column) {
        const int64_t pixel = static_cast<int64_t>(row) * p.width + column;
        const float depth = p.hypotheses[plane * p.plane_stride + row * p.row_stride +
                                         column * p.column_stride];
        const float* reference = p.features + pixel * C;
        float mean[C], value[kMaxViews][C];
        Corners at[kMaxViews];
        bool in_view[kMaxViews];
        for (int k = 0; k < C; ++k) mean[k] = reference[k];
        for (int view = 1; view < p.views; ++view) {
          in_view[view] = locate<C>(p, view, column + 0.5f, row + 0.5f, depth, &at[view]);
          if (!in_view[view]) continue;
          sample<C>(p.features + view * image, at[view], value[view]);
          for (int k = 0; k < C; ++k) mean[k] += value[view][k];
        }
        const T* incoming =
            volume_gradient + (static_cast<int64_t>(plane) * p.height * p.width + pixel) * C;
        float scaled[C];
        for (int k = 0; k < C; ++k) {
          mean[k] *= share;
          scaled[k] = 2.0f * share * as_float(incoming[k]);
        }
        float* target = gradient + pixel * C;
        for (int k = 0; k < C; ++k) target[k] += scaled[k] * (reference[k] - mean[k]);
        for (int view = 1; view < p.views; ++view) {
          if (!in_view[view]) continue;
          float flow[C];
          for (int k = 0; k < C; ++k) flow[k] = scaled[k] * (value[view][k] - mean[k]);
          for (int corner = 0; corner < 4; ++corner) {
            const float weight = at[view].weight[corner];
            float* into = gradient + view * image + at[view].offset[corner];
            for (int k = 0; k < C; ++k) into[k] += weight * flow[k];
          }
        }
      }
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
