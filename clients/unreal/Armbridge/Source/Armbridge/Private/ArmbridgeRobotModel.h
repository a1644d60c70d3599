#pragma once

#include "Core/Coordinates.h"
#include "CoreMinimal.h"

enum class EArmbridgeShape : uint8
{
	Box,
	Cylinder,
	Sphere,
	Mesh,
};

/** A shape of a link, placed in the link's frame; in ROS's axes, metres. */
struct FArmbridgeVisual
{
	FString Link;
	EArmbridgeShape Shape = EArmbridgeShape::Box;

	/** URL of a mesh on the server. */
	FString Mesh;

	/** Edges of a box, diameters and length of a cylinder along z, diameters of a sphere [m]; scale of a mesh. */
	Armbridge::FTriple Size;
	Armbridge::FTriple Position;
	Armbridge::FRotation Rotation;
	FLinearColor Color;
};

/** A joint of a URDF; its child link stands in its parent link at the origin, turned or shifted by the joint's position. */
struct FArmbridgeJoint
{
	FString Name;
	FString Parent;
	FString Child;
	bool bTurns = false;
	bool bSlides = false;
	Armbridge::FTriple Position;
	Armbridge::FRotation Rotation;
	Armbridge::FTriple Axis{1.0, 0.0, 0.0};
};

/** Links, shapes and joints of a URDF. */
struct FArmbridgeRobotModel
{
	TArray<FString> Links;
	TArray<FArmbridgeJoint> Joints;
	TArray<FArmbridgeVisual> Visuals;

	/** Reads a URDF that came from a URL, to which the names of meshes are relative. Returns false, and why, if it cannot. */
	bool Parse(const FString& Urdf, const FString& Url, FString& Error);
};
