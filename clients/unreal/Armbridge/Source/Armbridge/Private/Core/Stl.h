#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace Armbridge
{
/**
 * Reads a binary STL file: the corners of its triangles, nine numbers each, counter-clockwise seen from outside.
 * Returns false, and why, if it is no binary STL or is cut off.
 */
bool ParseStl(const std::vector<uint8_t>& File, std::vector<float>& Corners, std::string& Error);
}
