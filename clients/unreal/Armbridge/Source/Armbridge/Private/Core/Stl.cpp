#include "Stl.h"

#include <cstring>

namespace Armbridge
{
namespace
{
constexpr size_t Head = 84;
constexpr size_t TriangleBytes = 50;
constexpr size_t NormalBytes = 12;
constexpr size_t CornerBytes = 36;
}

bool ParseStl(const std::vector<uint8_t>& File, std::vector<float>& Corners, std::string& Error)
{
	if (File.size() < Head)
	{
		Error = "an STL file of " + std::to_string(File.size()) + " bytes; the head alone has " + std::to_string(Head);
		return false;
	}
	uint32_t Count = 0;
	std::memcpy(&Count, File.data() + Head - sizeof(Count), sizeof(Count));
	const uint64_t Needed = Head + static_cast<uint64_t>(Count) * TriangleBytes;
	if (File.size() < Needed)
	{
		Error = "no binary STL: " + std::to_string(Count) + " triangles need " + std::to_string(Needed) + " bytes, the file has "
			+ std::to_string(File.size());
		return false;
	}
	Corners.resize(static_cast<size_t>(Count) * 9);
	for (size_t Triangle = 0; Triangle < Count; ++Triangle)
	{
		// Each begins with its normal, which the corners give as well.
		std::memcpy(Corners.data() + Triangle * 9, File.data() + Head + Triangle * TriangleBytes + NormalBytes, CornerBytes);
	}
	return true;
}
}
