#pragma once

/** Unreal is left-handed, in centimetres: X ahead, Y right, Z up. ROS (REP 103) is right-handed, in metres: x ahead, y left, z up. */
namespace Armbridge
{
struct FTriple
{
	double X = 0.0;
	double Y = 0.0;
	double Z = 0.0;
};

/** A rotation as a unit quaternion. */
struct FRotation
{
	double X = 0.0;
	double Y = 0.0;
	double Z = 0.0;
	double W = 1.0;
};

inline FTriple RosFromUnreal(const FTriple& PositionCm)
{
	return {PositionCm.X / 100.0, -PositionCm.Y / 100.0, PositionCm.Z / 100.0};
}

inline FTriple UnrealFromRos(const FTriple& PositionM)
{
	return {PositionM.X * 100.0, -PositionM.Y * 100.0, PositionM.Z * 100.0};
}

/** A direction keeps its length. */
inline FTriple MirroredDirection(const FTriple& Direction)
{
	return {Direction.X, -Direction.Y, Direction.Z};
}

/** The same in both directions: the second mirror image is the original. */
inline FRotation MirroredRotation(const FRotation& Rotation)
{
	return {-Rotation.X, Rotation.Y, -Rotation.Z, Rotation.W};
}

/** The rotation by roll, pitch and yaw [rad] about fixed axes, as URDF writes it (rpy). */
FRotation FromRollPitchYaw(double Roll, double Pitch, double Yaw);
}
