#include "compiler/plan/settled.h"

#include <algorithm>
#include <set>

#include "compiler/plan/accessors.h"

namespace shale {
namespace {

constexpr uint32_t kTileWidth = 16, kTileHeight = 8;
constexpr uint32_t kLocal = 64;                     // invocations of a workgroup
constexpr uint32_t kNone = UINT32_MAX;              // in the tables
constexpr uint32_t kEntryWords = 12;                // of a pass in the tables
constexpr uint32_t kHeaderWords = 3;                // of what is kept
constexpr uint64_t kMostWords = uint64_t{1} << 24;  // any device binds so much
constexpr uint32_t kFirstCopy = uint32_t{1} << 31;  // in the list of copies
constexpr const char *kKept = "settled.kept", *kWork = "settled.work", *kMeans = "settled.means";

uint32_t ceil_div(uint64_t a, uint64_t b) { return static_cast<uint32_t>((a + b - 1) / b); }

/// Grid of so many invocations.
std::array<uint32_t, 3> groups(uint64_t invocations) {
  return {ceil_div(invocations, kLocal), 1, 1};
}

/// Tiles of the rendered picture.
struct Tiling {
  uint32_t width = kTileWidth, height = kTileHeight;  ///< of a tile, pixels
  uint32_t columns = 1, rows = 1;

  uint64_t count() const { return uint64_t{columns} * rows; }
  uint32_t row_words() const { return (columns + 31) / 32; }
  uint64_t words() const { return (2 + 2 * uint64_t{kSettledPhases}) * count(); }
};

Tiling tiling_of(FrameExtent render) {
  Tiling tiling;
  const auto set = [&] {
    tiling.columns = ceil_div(render.width, tiling.width);
    tiling.rows = ceil_div(render.height, tiling.height);
    return tiling.words();
  };
  while (set() > kMostWords) tiling.width *= 2, tiling.height *= 2;
  return tiling;
}

/// The tiles around pixels, of one axis, begin | end << 16: those that hold the pixels and one to either side.
uint32_t tiles_around(uint64_t begin, uint64_t end, uint32_t tile, uint32_t count) {
  const uint64_t first = std::min<uint64_t>(begin / tile, count - 1),
                 last = std::min<uint64_t>((std::max(end, begin + 1) - 1) / tile, count - 1);
  return static_cast<uint32_t>(first - std::min<uint64_t>(first, 1)) |
         static_cast<uint32_t>(std::min<uint64_t>(last + 2, count)) << 16;
}

/// How a pass runs.
struct Way {
  bool by_grid = false;                   ///< else always, and all of it
  std::optional<FrameSize> over;          ///< by a list: what it goes over
  std::vector<const FrameImage*> copied;  ///< by a list: histories that it writes
  bool is_shown = false;                  ///< stores of these go to an output of the host, too
  uint32_t ring = 0;                      ///< images of the longest of these
  bool makes_shown = false;               ///< Frame::settles's image is one of these
};

class Settling {
 public:
  Settling(Plan& plan, const LoweringOptions& options, bool is_linear, WeightBlob& weights)
      : variant_(plan.variant),
        options_(options),
        is_linear_(is_linear),
        weights_(weights),
        tiling_(tiling_of(options.render)) {
    for (const Param& param : variant_.params)
      if (param.source == ParamSource::kHost)
        for (uint32_t i = 0; i < param.components; ++i)
          params_.push_back(param.offset_bytes / 4 + i);
    counts_ = kHeaderWords + kSettledPhases * (static_cast<uint32_t>(params_.size()) + 1);
    ages_ = counts_ + static_cast<uint32_t>(tiling_.words());
    kept_ = static_cast<uint32_t>(variant_.resources.size());
    work_ = kept_ + 1;
    variant_.resources.push_back(words_image(kKept, Category::kImageHistory, 1));
    variant_.resources.push_back(words_image(kWork, Category::kImageInternal, 1));
    const FrameExtent shown =
        image_named(options.frame.settles->image)->size(options.render, options.output);
    const uint64_t words = 2 * uint64_t{shown.width} * shown.height;
    if (words <= kMostWords) {
      means_ = work_ + 1;
      variant_.resources.push_back(words_image(kMeans, Category::kImageHistory, words));
    }
  }

  Result<void> add(std::vector<RunPass>& passes) {
    std::vector<Way> ways;
    bool keeps = false;
    for (const RunPass& each : passes) {
      SHALE_TRY(ways.emplace_back(), way_of(each));
      keeps = keeps || ways.back().makes_shown;
    }
    if (!keeps)
      return bad_input("frame.settles",
                       "no pass that calls invocation() writes the history \"{}\" alone",
                       options_.frame.settles->image);
    // Marks, then commands, then lists; of a pass with a copy two of each.
    uint32_t words = tiling_.rows * tiling_.row_words(), ages = ages_;
    std::vector<uint32_t> tables, ranges;
    uint32_t entries = 0, most = 1;
    const auto take = [&](uint32_t count) { return std::exchange(words, words + count); };
    std::vector<RunPass> all;
    SHALE_TRY_VOID(add_head(all, passes));
    const size_t find = all.size();
    all.emplace_back();
    const uint32_t passes_by_grid = static_cast<uint32_t>(
        std::count_if(ways.begin(), ways.end(), [](const Way& way) { return way.by_grid; }));
    for (size_t i = 0; i < passes.size(); ++i) {
      const Way& way = ways[i];
      RunPass& pass = passes[i];
      if (!way.by_grid) {
        all.push_back(std::move(pass));
        continue;
      }
      SHALE_TRY(const auto grid, workgroups_of(variant_, pass.pass, options_));
      const uint32_t columns = way.over ? grid[0] : 1, rows = way.over ? grid[1] : 1,
                     count = columns * rows;
      most = std::max(most, count);
      std::array<uint32_t, kEntryWords> entry{columns, rows,  kNone, grid[0], grid[1], grid[2],
                                              take(3), kNone, kNone, 0,       0,       0};
      pass.grid = IndirectGrid{work_, entry[6]};
      if (way.over) {
        entry[2] = take(count);
        pass.list = WorkgroupList{work_, entry[2], columns};
      }
      std::optional<RunPass> copy, mean;
      const bool has_mean = way.makes_shown && means_;
      if (!way.copied.empty()) {
        entry[7] = take(count);
        entry[8] = take(3);
        // A mean is in none of the ring's images.
        entry[9] = way.is_shown ? kNone : way.ring - (has_mean ? 0 : 1);
        entry[10] = std::exchange(ages, ages + count);
        copy = copy_of(pass.pass, way, entry[7], entry[8], count, columns, has_mean);
        if (has_mean) mean = mean_of(pass, way);
        pass.is_last_form = false;  // an output gets what both leave
      }
      entry[11] = passes_by_grid * kEntryWords + static_cast<uint32_t>(ranges.size());
      add_ranges(ranges, pass.pass, way, columns, rows);
      tables.insert(tables.end(), entry.begin(), entry.end());
      ++entries;
      all.push_back(std::move(pass));
      if (copy) all.push_back(std::move(*copy));
      if (mean) all.push_back(std::move(*mean));
    }
    tables.insert(tables.end(), ranges.begin(), ranges.end());
    all[find] = generated("settled_find", "settled_find.glsl", {ceil_div(most, kLocal), entries, 1},
                          {buffer(add_tables(tables), true, false), buffer(kept_, true, true),
                           buffer(work_, true, true)});
    all[find].pass.defines.emplace_back("ENTRY_WORDS", fmt::format("{}", kEntryWords));
    add_rest(all);
    kept_words_ = std::max(kept_words_, ages);
    work_words_ = std::max(work_words_, words);
    passes = std::move(all);
    return {};
  }

  void finish() {
    variant_.resources[kept_] = words_image(kKept, Category::kImageHistory, kept_words_);
    variant_.resources[work_] = words_image(kWork, Category::kImageInternal, work_words_);
  }

 private:
  const FrameImage* image_named(const std::string& name) const {
    for (const FrameImage& image : options_.frame.images)
      if (image.name == name) return &image;
    return nullptr;
  }

  /// What a pass goes over, where that follows from the frame's size.
  std::optional<FrameSize> over_of(const FramePass& pass) const {
    if (pass.over_size) return pass.over_size;
    if (const FrameImage* image = image_named(pass.over)) return image->size;
    for (const FrameTensor& tensor : options_.frame.tensors)
      if (tensor.name == pass.over) return tensor.size;
    return std::nullopt;
  }

  Result<Way> way_of(const RunPass& run) const {
    const FramePass& pass = run.pass;
    Way way;
    if (!pass.graph.empty()) return way;
    way.over = over_of(pass);
    SHALE_TRY(const auto grid, workgroups_of(variant_, pass, options_));
    if (run.glsl.find("invocation()") == std::string::npos || grid[0] * grid[1] > kMaxWorkgroups)
      way.over.reset();
    way.by_grid = true;
    for (const FrameBinding& binding : pass.bindings) {
      if (!binding.writes) continue;
      const FrameImage* image = image_named(binding.name);
      const bool is_ring =
          image ? image->history_depth != 0
                : std::any_of(options_.frame.tensors.begin(), options_.frame.tensors.end(),
                              [&](const FrameTensor& tensor) {
                                return tensor.name == binding.name && tensor.history_depth != 0;
                              });
      const bool is_cleared = std::any_of(
          options_.frame.programs.begin(), options_.frame.programs.end(),
          [&](const FrameProgram& program) {
            return std::any_of(
                program.passes.begin(), program.passes.end(), [&](const FramePass& other) {
                  return std::find(other.clears.begin(), other.clears.end(), binding.name) !=
                         other.clears.end();
                });
          });
      if (binding.reads || is_cleared) way.over.reset();
      if (image && image->category == Category::kImageOutput) way.by_grid = false;
      if (!is_ring) continue;
      // A part of a pixel's place in the invocation must be whole.
      if (!image || !way.over || way.over->of_output != image->size.of_output ||
          way.over->divide[0] % image->size.divide[0] != 0 ||
          way.over->divide[1] % image->size.divide[1] != 0) {
        way.by_grid = false;
      } else {
        way.copied.push_back(image);
        way.makes_shown = way.makes_shown || image->name == options_.frame.settles->image;
      }
      if (image) way.ring = std::max(way.ring, image->history_depth);
      for (const FrameImage& shows : options_.frame.images)
        way.is_shown = way.is_shown || (!is_linear_ && shows.shows == image->name);
    }
    if (!way.by_grid || !way.over) {
      way.by_grid = way.by_grid && way.copied.empty();
      way.over.reset();
      way.copied.clear();
      way.makes_shown = false;
      return way;
    }
    // What it leaves of one frame is what others find in the next.
    for (const FrameBinding& binding : pass.bindings)
      for (Resource& resource : variant_.resources)
        if (binding.writes && resource.name == binding.name &&
            resource.category == Category::kImageInternal)
          resource.category = Category::kImageHistory, resource.history_depth = 1;
    return way;
  }

  Binding buffer(uint32_t resource, bool reads, bool writes) const {
    return {.binding = 0,
            .type = BindingType::kStorageBuffer,
            .resource = resource,
            .view_format = ImageFormat::kNone,
            .reads = reads,
            .writes = writes,
            .frames_back = 0};
  }

  /// A pass of a shader in shaders/include; `text` goes behind it.
  RunPass generated(std::string name, const char* file, std::array<uint32_t, 3> grid,
                    std::vector<Binding> buffers, const std::string& text = "") const {
    RunPass run;
    run.pass.name = std::move(name);
    run.pass.workgroup[0] = kLocal;
    run.pass.workgroup[1] = 1;
    const auto define = [&](const char* key, uint64_t value) {
      run.pass.defines.emplace_back(key, fmt::format("{}", value));
    };
    define("RENDER_WIDTH", options_.render.width);
    define("RENDER_HEIGHT", options_.render.height);
    define("TILE_WIDTH", tiling_.width);
    define("TILE_HEIGHT", tiling_.height);
    define("COLUMNS", tiling_.columns);
    define("ROWS", tiling_.rows);
    define("TILES", tiling_.count());
    define("ROW_WORDS", tiling_.row_words());
    define("COUNTS", counts_);
    define("RESTS", counts_ + tiling_.count());
    define("HASHES", counts_ + 2 * tiling_.count());
    define("SETTLED", kSettledFrames + 1);
    define("PHASES", kSettledPhases);
    define("FIRST_COPY", kFirstCopy);
    run.glsl =
        fmt::format("#version 450\n#include \"access.glsl\"\n#include \"{}\"\n{}", file, text);
    run.workgroups = grid;
    run.buffers = std::move(buffers);
    return run;
  }

  /// phase and look, for the host's images that the passes read.
  Result<void> add_head(std::vector<RunPass>& all, std::span<const RunPass> passes) {
    RunPass phase =
        generated("settled_phase", "settled_phase.glsl", {1, 1, 1}, {buffer(kept_, true, true)});
    const auto define = [&](const char* key, std::string value) {
      phase.pass.defines.emplace_back(key, std::move(value));
    };
    define("PARAMS", fmt::format("{}", params_.size()));
    define("PARAM_WORDS", fmt::format("{}", param_bytes(variant_) / 4));
    std::string places;
    for (const uint32_t word : params_)
      places += fmt::format("{}{}u", places.empty() ? "" : ", ", word);
    define("PARAM_PLACES", places);
    phase.pass.clears.emplace_back(kWork);
    all.push_back(std::move(phase));

    std::string text = R"(void look_at(ivec2 tile) {
  const ivec2 render = ivec2(RENDER_WIDTH, RENDER_HEIGHT), first = tile * ivec2(TILE_WIDTH, TILE_HEIGHT),
              last = min(first + ivec2(TILE_WIDTH, TILE_HEIGHT), render);
)";
    std::set<std::string> names;
    for (const RunPass& each : passes)
      for (const FrameBinding& binding : each.pass.bindings) {
        const FrameImage* image = image_named(binding.name);
        if (image && image->category == Category::kImageInput) names.insert(binding.name);
      }
    std::vector<FrameBinding> bindings;
    for (const std::string& name : names) {
      SHALE_TRY(const uint32_t index, find_resource(variant_, name, "frame.settles"));
      const Resource& image = variant_.resources[index];
      const uint32_t bytes = image_format_info(image.format).texel_bytes;
      const uint32_t at_once = image.format == ImageFormat::kRgba8Snorm ? 1
                               : bytes == 8                             ? 2
                               : bytes == 4                             ? 4
                                                                        : 1;
      const std::string verb = at_once == 1 ? "fetch" : fmt::format("fetch{}", at_once);
      const std::string fetch = at_once == 1
                                    ? fmt::format("look(fetch_{}(ivec2(x, y)));", name)
                                    : fmt::format(
                                          "{2} t[{0}]; fetch{0}_{1}(ivec2(x, y), t); "
                                          "[[unroll]] for (int i = 0; i < {0}; ++i) look(t[i]);",
                                          at_once, name, fetched_type(image.format));
      text += fmt::format(R"(  {{
    const ivec2 size = ivec2({}, {}), begin = first * size / render, end = last * size / render;
    for (int y = begin.y; y < end.y; ++y)
      for (int x = begin.x / {}; {} * x < end.x; ++x) {{ {} }}
  }}
)",
                          image.width, image.height, at_once, at_once, fetch);
      bindings.push_back({name, name, true, false, 0});
    }
    RunPass look = generated("settled_look", "settled_look.glsl", groups(tiling_.count()),
                             {buffer(kept_, true, true), buffer(work_, true, true)}, text + "}\n");
    look.pass.bindings = std::move(bindings);
    all.push_back(std::move(look));
    return {};
  }

  void add_rest(std::vector<RunPass>& all) {
    const FrameSettles& settles = *options_.frame.settles;
    RunPass rest = generated("settled_rest", "settled_rest.glsl", groups(tiling_.count()),
                             {buffer(kept_, true, true), buffer(work_, true, false)});
    rest.pass.bindings = {{settles.image, "shown", true, false, 0},
                          {settles.image, "past", true, false, 1}};
    if (settles.exposure.empty()) {
      rest.pass.defines.emplace_back("EXPOSURE", "1.0");
    } else {
      rest.pass.defines.emplace_back("EXPOSURE", "params." + settles.exposure);
      rest.glsl.insert(rest.glsl.find("#include \"settled"), "SHALE_PARAMS;\n");
    }
    rest.pass.defines.emplace_back("LIMIT", fmt::format("{}.0", *options_.tiles));
    rest.is_rare = true;  // while things settle
    all.push_back(std::move(rest));
  }

  /// What of an image a workgroup of a pass makes.
  static std::array<uint32_t, 2> side_of(const FramePass& pass, const Way& way,
                                         const FrameImage& image) {
    const auto side = [&](size_t axis) {
      return pass.workgroup[axis] * way.over->divide[axis] / image.size.divide[axis];
    };
    return {side(0), side(1)};
  }

  /// Follows what a pass by a list shows to its mean.
  RunPass mean_of(const RunPass& made, const Way& way) const {
    const std::string& shown = options_.frame.settles->image;
    RunPass mean = generated(
        "settled_mean", "settled_mean.glsl", {1, 1, 1},
        {buffer(kept_, true, false), buffer(work_, true, false), buffer(*means_, true, true)});
    mean.pass.bindings = {{shown, "shown", true, false, 0}, {shown, "past", true, false, 1}};
    const auto side = side_of(made.pass, way, *image_named(shown));
    for (const auto& [key, value] :
         {std::pair{"LIST", made.list->first}, std::pair{"LIST_COLUMNS", made.list->columns},
          std::pair{"SIDE_X", side[0]}, std::pair{"SIDE_Y", side[1]}})
      mean.pass.defines.emplace_back(key, fmt::format("{}", value));
    mean.grid = made.grid;
    mean.is_rare = true;  // while things settle
    return mean;
  }

  /// Copies parts of the pass's histories from the frame before: those of the workgroups of a list; the first time,
  /// where there is one, the mean of what is shown.
  RunPass copy_of(const FramePass& pass, const Way& way, uint32_t list, uint32_t command,
                  uint32_t count, uint32_t columns, bool has_mean) const {
    RunPass copy;
    copy.pass.name = "keep_" + pass.name;
    copy.pass.workgroup[0] = kLocal;
    copy.pass.workgroup[1] = 1;
    copy.buffers = {buffer(work_, true, false)};
    copy.glsl = R"(#version 450
#include "access.glsl"
#include "color.glsl"
layout(local_size_x = LOCAL_X) in;
layout(set = 0, binding = FREE_BINDING, std430) readonly buffer Work { uint d[]; } work;
)";
    if (has_mean) {
      copy.buffers.push_back(buffer(*means_, true, false));
      copy.glsl += fmt::format(
          R"(layout(set = 0, binding = FREE_BINDING + 1, std430) readonly buffer Means {{ uvec2 d[]; }} means;
HALF4 mean_of(HALF4 past, ivec2 at) {{
  const uvec2 away = means.d[at.y * {} + at.x];
  return half4(finite_color(rgb_of(past) + vec3(unpackHalf2x16(away.x), unpackHalf2x16(away.y).x)));
}}
)",
          image_named(options_.frame.settles->image)->size(options_.render, options_.output).width);
    }
    copy.glsl += fmt::format(R"(void main() {{
  const uint entry = work.d[{0} + gl_WorkGroupID.x];
  const int own = int(entry & {2}u);
  const ivec2 place = ivec2(own % {1}, own / {1});
)",
                             list, columns, kFirstCopy - 1);
    for (const FrameImage* image : way.copied) {
      const FrameExtent size = image->size(options_.render, options_.output);
      const auto side = side_of(pass, way, *image);
      const std::string past = "past_" + image->name;
      std::string fetched = fmt::format("fetch_{}(at)", past);
      if (has_mean && image->name == options_.frame.settles->image)
        fetched =
            fmt::format("entry > {}u ? mean_of({}, at) : {}", kFirstCopy - 1, fetched, fetched);
      copy.glsl += fmt::format(
          R"(  for (int i = int(gl_LocalInvocationID.x); i < {0} * {1}; i += LOCAL_X) {{
    const ivec2 at = place * ivec2({0}, {1}) + ivec2(i % {0}, i / {0});
    if (at.x < {2} && at.y < {3}) store_{4}(at, {5});
  }}
)",
          side[0], side[1], size.width, size.height, image->name,
          image->format == ImageFormat::kRgba8Snorm ? "snorm_word(snorm_of(" + fetched + "))"
                                                    : fetched);
      copy.pass.bindings.push_back({image->name, image->name, false, true, 0});
      copy.pass.bindings.push_back({image->name, past, true, false, 1});
    }
    copy.glsl += "}\n";
    copy.workgroups = {count, 1, 1};
    copy.grid = IndirectGrid{work_, command};
    copy.is_rare = true;
    return copy;
  }

  /// The tiles that let columns and rows of workgroups run.
  void add_ranges(std::vector<uint32_t>& ranges, const FramePass& pass, const Way& way,
                  uint32_t columns, uint32_t rows) const {
    for (const size_t axis : {0u, 1u}) {
      const uint32_t render = axis == 0 ? options_.render.width : options_.render.height,
                     output = axis == 0 ? options_.output.width : options_.output.height,
                     tile = axis == 0 ? tiling_.width : tiling_.height,
                     tiles = axis == 0 ? tiling_.columns : tiling_.rows,
                     count = axis == 0 ? columns : rows;
      for (uint32_t i = 0; i < count; ++i) {
        if (!way.over) {
          ranges.push_back(tiles << 16);
          continue;
        }
        const uint64_t side = uint64_t{pass.workgroup[axis]} * way.over->divide[axis];
        const uint64_t begin = i * side, end = begin + side;
        ranges.push_back(
            way.over->of_output
                ? tiles_around(begin * render / output, ceil_div(end * render, output), tile, tiles)
                : tiles_around(begin, end, tile, tiles));
      }
    }
  }

  /// The tables as weights of the package, as a device reads them.
  uint32_t add_tables(const std::vector<uint32_t>& tables) {
    std::vector<uint8_t> bytes(tables.size() * sizeof(uint32_t));
    for (size_t i = 0; i < bytes.size(); ++i)
      bytes[i] = static_cast<uint8_t>(tables[i / 4] >> (8 * (i % 4)));
    Resource resource;
    resource.name = "settled.tables";
    while (std::any_of(variant_.resources.begin(), variant_.resources.end(),
                       [&](const Resource& other) { return other.name == resource.name; }))
      resource.name += '#';
    resource.category = Category::kWeights;
    resource.dtype = DType::kInt32;
    resource.shape = {static_cast<int64_t>(tables.size())};
    resource.size_bytes = bytes.size();
    resource.offset_bytes = weights_.add(bytes);
    variant_.resources.push_back(std::move(resource));
    return static_cast<uint32_t>(variant_.resources.size() - 1);
  }

  Variant& variant_;
  const LoweringOptions& options_;
  bool is_linear_;
  WeightBlob& weights_;
  Tiling tiling_;
  std::vector<uint32_t> params_;   ///< words of the host's
  uint32_t kept_ = 0, work_ = 0;   ///< resources
  std::optional<uint32_t> means_;  ///< likewise, where a device binds so much
  uint32_t counts_ = 0, ages_ = 0, kept_words_ = 0, work_words_ = 0;
};

}  // namespace

Result<void> settle(Plan& plan, std::span<std::vector<RunPass>> programs,
                    const LoweringOptions& options, bool is_linear, WeightBlob& weights) {
  const Frame& frame = options.frame;
  for (const std::vector<RunPass>& passes : programs)
    for (const RunPass& each : passes)
      if (each.runs != Runs::kInAllFrames) return {};
  if (frame.chosen_by.empty() &&
      std::count_if(frame.programs.begin(), frame.programs.end(),
                    [](const FrameProgram& program) { return !program.generates; }) != 1)
    return bad_input("frame.settles", "is for frames of which one program renders");
  Settling settling(plan, options, is_linear, weights);
  for (size_t i = 0; i < programs.size(); ++i)
    if (!frame.programs[i].generates) SHALE_TRY_VOID(settling.add(programs[i]));
  settling.finish();
  return {};
}

}  // namespace shale
