#include "Coordinates.h"

#include <cmath>

namespace Armbridge
{
FRotation FromRollPitchYaw(double Roll, double Pitch, double Yaw)
{
	const double CR = std::cos(Roll / 2.0), SR = std::sin(Roll / 2.0);
	const double CP = std::cos(Pitch / 2.0), SP = std::sin(Pitch / 2.0);
	const double CY = std::cos(Yaw / 2.0), SY = std::sin(Yaw / 2.0);
	return {
		SR * CP * CY - CR * SP * SY,
		CR * SP * CY + SR * CP * SY,
		CR * CP * SY - SR * SP * CY,
		CR * CP * CY + SR * SP * SY};
}
}
