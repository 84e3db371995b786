#include "compiler/plan/tile_plan.h"

#include <algorithm>

#include "compiler/plan/reach.h"
#include "ir/base/integer.h"

namespace shale {
namespace {

/// Positions of the smallest tile: rows are long, as cells are, and 32 columns of up to 1024 make one word.
constexpr int64_t kTileRows = 8, kTileColumns = 32;
constexpr uint32_t kNoList = UINT32_MAX;  // in the tables
constexpr size_t kEntryWords = 7;         // of a dispatch in the tables

uint32_t word(int64_t value) { return static_cast<uint32_t>(value); }

/// Tiles that hold the positions, as begin | end << 16.
uint32_t tiles_of(const Stretch& positions, int64_t tile) {
  if (positions.begin >= positions.end) return 0;
  return word(positions.begin / tile | ceil_div(positions.end, tile) << 16);
}

/// An entry of the tables with a word for each input, column and row of cells, from `stretch`.
template <typename TilesOf>
void add_entry(TilePlan& plan, size_t index, uint32_t list, std::array<uint32_t, 3> grid,
               size_t columns, size_t rows, const TilesOf& tiles) {
  const size_t entry = 2 * plan.inputs.size() + kEntryWords * index;
  const uint32_t lines[kEntryWords] = {word(static_cast<int64_t>(columns)),
                                       word(static_cast<int64_t>(rows)),
                                       list,
                                       grid[0],
                                       grid[1],
                                       grid[2],
                                       word(static_cast<int64_t>(plan.tables.size()))};
  std::copy(std::begin(lines), std::end(lines),
            plan.tables.begin() + static_cast<std::ptrdiff_t>(entry));
  for (size_t input = 0; input < plan.inputs.size(); ++input) {
    for (size_t i = 0; i < columns; ++i) plan.tables.push_back(tiles(input, kColumnAxis, i));
    for (size_t i = 0; i < rows; ++i) plan.tables.push_back(tiles(input, kRowAxis, i));
  }
  plan.most_cells = std::max(plan.most_cells, word(static_cast<int64_t>(columns * rows)));
}

ModuleSource tile_source(const char* file, Defines defines) {
  return {.glsl = fmt::format("#version 450\n#include \"{}\"\n", file),
          .optimize = OptimizeBy::kSpirvOpt,
          .defines = std::move(defines),
          .where = file,
          .load = {}};
}

Defines tile_defines(const InputTiles& tiles) {
  const char* type = tiles.unit_bytes == 16 ? "uvec4" : tiles.unit_bytes == 4 ? "uint" : "int8_t";
  Defines defines{{"UNIT", type}};
  for (const auto& [name, value] : {std::pair{"HEIGHT", tiles.height},
                                    {"IMAGES", tiles.images},
                                    {"ROW_UNITS", tiles.row_units},
                                    {"TILE_UNITS", tiles.tile_units},
                                    {"TILE_ROWS", tiles.tile_rows},
                                    {"COLUMNS", tiles.columns},
                                    {"UNIT_BYTES", tiles.unit_bytes},
                                    {"FIRST_WORD", tiles.first_word},
                                    {"ROW_WORDS", tiles.row_words()},
                                    {"LOCAL_X", kTileLocalX}})
    defines.emplace_back(name, fmt::format("{}", value));
  return defines;
}

}  // namespace

InputTiles input_tiles(const TensorType& type) {
  const bool is_picture = type.shape.size() == 4;
  const int64_t bytes = dtype_info(type.dtype).host_bytes, width = is_picture ? type.shape[2] : 1,
                pixel = is_picture ? type.shape[3] * bytes
                                   : element_count(type.shape).value_or(0) * bytes;
  InputTiles tiles;
  tiles.images = is_picture ? type.shape[0] : 1;
  tiles.height = is_picture ? type.shape[1] : 1;
  tiles.tile_rows = std::min(kTileRows, tiles.height);
  tiles.tile_columns = kTileColumns;
  const auto count = [&] {
    tiles.rows = ceil_div(tiles.height, tiles.tile_rows);
    tiles.columns = ceil_div(width, tiles.tile_columns);
    return tiles.rows * tiles.columns;
  };
  while (count() > kMaxWorkgroups) tiles.tile_rows *= 2, tiles.tile_columns *= 2;
  while (tiles.unit_bytes < 16 && width * pixel % (4 * tiles.unit_bytes) == 0)
    tiles.unit_bytes *= 4;
  tiles.row_units = width * pixel / tiles.unit_bytes;
  tiles.tile_units =
      tiles.columns == 1 ? tiles.row_units : tiles.tile_columns * pixel / tiles.unit_bytes;
  return tiles;
}

TilePlan plan_tiles(const Graph& graph, std::span<const CommandedDispatch> dispatches) {
  TilePlan plan;
  for (const ValueId input : graph.inputs) {
    InputTiles tiles = input_tiles(graph.value(input).type);
    tiles.first_word = plan.change_words;
    plan.change_words += word(tiles.rows * tiles.row_words());
    plan.tables.insert(plan.tables.end(), {word(tiles.first_word), word(tiles.row_words())});
    plan.inputs.push_back(tiles);
  }
  const size_t count = plan.inputs.size() + dispatches.size();
  plan.tables.resize(plan.tables.size() + kEntryWords * count);
  plan.work_words = TilePlan::command(count);
  const auto add_list = [&](size_t cells) {
    plan.lists.push_back(plan.work_words);
    plan.work_words += word(static_cast<int64_t>(cells));
    return plan.lists.back();
  };
  for (size_t i = 0; i < plan.inputs.size(); ++i) {
    const InputTiles& own = plan.inputs[i];
    const size_t columns = static_cast<size_t>(own.columns), rows = static_cast<size_t>(own.rows);
    add_entry(plan, i, add_list(columns * rows), {word(own.columns * own.rows), 1, 1}, columns,
              rows, [&](size_t input, size_t, size_t at) {
                const int64_t tile = static_cast<int64_t>(at);
                return input == i ? word(tile | (tile + 1) << 16) : 0;
              });
  }
  for (size_t i = 0; i < dispatches.size(); ++i) {
    const CommandedDispatch& dispatch = dispatches[i];
    const auto whole = [&](size_t axis) {
      return std::vector<Stretch>{{0, extent_along(graph, dispatch.result, axis)}};
    };
    const std::vector<Stretch> columns =
                                   dispatch.cells ? dispatch.cells->columns : whole(kColumnAxis),
                               rows = dispatch.cells ? dispatch.cells->rows : whole(kRowAxis);
    std::map<size_t, std::vector<std::vector<Stretch>>> reached;  // by axis, then by column or row
    for (const Stretch& part : columns)
      reached[kColumnAxis].push_back(reach(graph, dispatch.result, kColumnAxis, part));
    for (const Stretch& part : rows)
      reached[kRowAxis].push_back(reach(graph, dispatch.result, kRowAxis, part));
    uint32_t list = kNoList;
    if (dispatch.cells)
      list = add_list(columns.size() * rows.size());
    else
      plan.lists.push_back(0);
    add_entry(plan, plan.inputs.size() + i, list, dispatch.workgroups, columns.size(), rows.size(),
              [&](size_t input, size_t axis, size_t at) {
                const InputTiles& own = plan.inputs[input];
                return tiles_of(reached[axis][at][input],
                                axis == kColumnAxis ? own.tile_columns : own.tile_rows);
              });
  }
  return plan;
}

ModuleSource compare_source(const InputTiles& tiles, uint32_t tolerance) {
  Defines defines = tile_defines(tiles);
  defines.emplace_back("TOLERANCE", fmt::format("{}", tolerance));
  return tile_source("tiles_compare.glsl", std::move(defines));
}

ModuleSource find_source(const TilePlan& plan) {
  return tile_source("tiles_find.glsl", {{"INPUTS", fmt::format("{}", plan.inputs.size())},
                                         {"ENTRY_WORDS", fmt::format("{}", kEntryWords)},
                                         {"LOCAL_X", fmt::format("{}", kTileLocalX)}});
}

ModuleSource keep_source(const InputTiles& tiles, uint32_t list) {
  Defines defines = tile_defines(tiles);
  defines.emplace_back("LIST", fmt::format("{}", list));
  return tile_source("tiles_keep.glsl", std::move(defines));
}

}  // namespace shale
