// tools/layer/extensions.h -- what the layer offers on a physical device.
#pragma once

#include <span>
#include <string_view>

#include "tools/layer/layer.h"

namespace shale::layer {

/// True if the layer, and not the device, offers the extension there.
bool offered(const Physical& physical, std::string_view extension);

/// Features and properties of the layer's structures in a chain of results.
void fill_features(const Physical& physical, void* chain);
void fill_properties(const Physical& physical, void* chain);

}  // namespace shale::layer
