// compiler/plan/tile_plan.h -- how a network's segment finds out which cells of its dispatches have to run again.
//
// Three kinds of dispatches before those of the network: one for each input compares it with a copy of what the network
// was last given, by tiles; one finds for all dispatches the cells that a changed tile reaches, and writes lists and commands;
// and one for each input brings the copy up to date where tiles changed. The network reads the copies.
#pragma once

#include <string>
#include <vector>

#include "compiler/plan/plan.h"

namespace shale {

/// The tiles of an input. Of a tensor that is no picture there is one.
struct InputTiles {
  int64_t height = 1;  ///< rows of all of it, for one image
  int64_t images = 1;
  int64_t row_units = 1;                    ///< units of `unit_bytes` from one row to the next
  int64_t tile_units = 1;                   ///< units of a row in a tile
  int64_t tile_rows = 1, tile_columns = 1;  ///< positions of a tile
  int64_t rows = 1, columns = 1;            ///< tiles
  int64_t unit_bytes = 1;                   ///< 16, 4 or 1
  int64_t first_word = 0;                   ///< of Tiles::changes

  int64_t row_words() const { return (columns + 31) / 32; }
};

/// As small as gives at most kMaxWorkgroups tiles.
InputTiles input_tiles(const TensorType& type);

/// A dispatch that runs by a command: its grid, and the cells if it has a list.
struct CommandedDispatch {
  ValueId result;
  std::array<uint32_t, 3> workgroups{1, 1, 1};
  std::optional<Cells> cells;
};

/// Where commands, lists and changed tiles lie, and which tiles make a cell run.
struct TilePlan {
  std::vector<InputTiles> inputs;  ///< of each graph input
  std::vector<uint32_t>
      lists;  ///< of the copy of each input, then of each dispatch: words; 0 where there is none
  uint32_t change_words = 1, work_words = 0;  ///< the first word of changes is 0 but where all runs
  uint32_t most_cells = 1;                    ///< of a dispatch
  std::vector<uint32_t> tables;               ///< what tiles_find.glsl reads

  /// Words to the command of the copy of an input, or of a dispatch behind them all.
  static uint32_t command(size_t index) { return static_cast<uint32_t>(4 * index); }
};
TilePlan plan_tiles(const Graph& graph, std::span<const CommandedDispatch> dispatches);

/// The sources of the three kinds.
ModuleSource compare_source(const InputTiles& tiles, uint32_t tolerance);
ModuleSource find_source(const TilePlan& plan);
ModuleSource keep_source(const InputTiles& tiles, uint32_t list);

/// Invocations of a workgroup of all three.
inline constexpr int64_t kTileLocalX = 64;

}  // namespace shale
