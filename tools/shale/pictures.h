// tools/shale/pictures.h -- pictures that lie on disk, as what is compared.
#pragma once

#include <map>
#include <string>

#include "tools/scene/frame_source.h"

namespace shale {

/// The extension in small letters, with its point.
std::string extension_of(const std::string& path);

/// As a display shows it, RGB in steps of 1/255: OpenEXR pictures are linear HDR, which is multiplied by `exposure` and
/// tone-mapped; the others are that already.
/// Errors: kIo; kBadInput; kUnsupported for more than 2^26 pixels.
Result<FloatImage> load_display(const std::string& path, float exposure);

/// Pictures of a folder by name without extension.
/// Errors: kIo; kBadInput if there is none, or two of one name.
Result<std::map<std::string, std::string>> pictures_of(const std::string& folder);

}  // namespace shale
