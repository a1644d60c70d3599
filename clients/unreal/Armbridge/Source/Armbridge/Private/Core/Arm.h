#pragma once

#include "Coordinates.h"

#include <cstdint>
#include <string>
#include <vector>

/** The conversation with a server: frames out, frames in, events. Without Unreal, without exceptions, without I/O. */
namespace Armbridge
{
/** MoveIt's COMMUNICATION_FAILURE: the connection was lost before a goal's end came. */
constexpr int ConnectionLost = -25;

/** Seconds before the first new connection, and the most. */
constexpr double FirstDelayS = 0.5;
constexpr double LongestDelayS = 10.0;

inline double NextDelay(double DelayS)
{
	return DelayS * 2.0 < LongestDelayS ? DelayS * 2.0 : LongestDelayS;
}

struct FEvent
{
	enum class EKind
	{
		Joints,
		GoalEnded,
		GripperEnded,
		Refused,
	};

	EKind Kind = EKind::Refused;

	/** Of GoalEnded: MoveIt's error code, 1 for success. Of GripperEnded: 1 if it is there or holds something, else 0. */
	int Code = 0;
	std::string Message;

	/** Of Joints. */
	std::vector<std::string> Names;
	std::vector<double> PositionsRad;
};

/** A goal that was asked: its frame, or empty and why it cannot be sent. */
struct FRequest
{
	std::string Frame;
	std::string Error;
};

/** Matches goals to their ends. A new goal takes the place of the one before. */
class FArm
{
public:
	/** Frames that begin each connection. An authentication token comes first. */
	static std::vector<std::string> Setup(const std::string& Token);

	static std::string Stop();

	FRequest MoveToNamed(const std::string& Target);

	/** @param NowMs milliseconds since 1970; each goal gets its own stamp from it. */
	FRequest MoveJoints(int64_t NowMs, const std::vector<std::string>& Names, const std::vector<double>& PositionsRad);

	/** @param Position of the tip in the arm's base, in ROS's axes [m]. @param Rotation null: the planner chooses. */
	FRequest MoveTip(int64_t NowMs, const FTriple& Position, const FRotation* Rotation);

	/** @param MaxEffort greatest torque as a share of the servo's, 0 for the server's own. */
	FRequest MoveGripper(double PositionRad, double MaxEffort);

	/** Takes a frame of the server. Frames that are no JSON, or for somebody else, have no events. */
	std::vector<FEvent> Take(const std::string& Frame);

	/** The connection was lost: what was asked on it is not answered on the next one. */
	std::vector<FEvent> Lose();

private:
	std::string NewStamp(int64_t NowMs);

	int Goals = 0;

	// What identifies the latest goal in its statuses: its stamp, or that it was a named one, which has no stamp.
	std::string GoalStamp;
	bool bNamed = false;

	// Named goals whose end has not come: a goal that another one replaces ends as well, on the same topic.
	int NamedWaiting = 0;
	std::string GripperId;
};
}
